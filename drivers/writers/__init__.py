"""Write a log from messages: CARMEN, URG text, ROS 1 bag, ROS 2 bag (sqlite3, MCAP); and ground truth."""

from drivers.writers.log import FORMATS, write_log
from drivers.writers.truth import write_relations, write_tum

__all__ = ["FORMATS", "write_log", "write_relations", "write_tum"]
