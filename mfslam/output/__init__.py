"""What a run leaves behind, and readers of the same files."""

from mfslam.output.covariance import read_covariances
from mfslam.output.folder import prepare_folder, run_folder, write_run
from mfslam.output.graph_reader import read_graph
from mfslam.output.maps import read_map
from mfslam.output.staging import check_outputs, check_writable, write_atomically
from mfslam.output.summary import json_text, summarise
from mfslam.output.tum import read_tum

__all__ = [
    "check_outputs",
    "check_writable",
    "json_text",
    "prepare_folder",
    "read_covariances",
    "read_graph",
    "read_map",
    "read_tum",
    "run_folder",
    "summarise",
    "write_atomically",
    "write_run",
]
