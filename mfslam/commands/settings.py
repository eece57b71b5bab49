"""The settings of a run: the log's own presets, then what the user says."""

from __future__ import annotations

import argparse
from pathlib import Path

from drivers.base import TopicChoice
from drivers.logs import default_presets
from mfslam.config import Config
from mfslam.settings import load, preset_path


def config_for(log: Path, args: argparse.Namespace) -> Config:
    """Layers for a log: presets of its format, --preset, --config, --set."""
    files: list[Path] = [preset_path(name) for name in [*default_presets(log), *args.preset]]
    if args.config is not None:
        files.append(args.config)
    return load(files, args.settings)


def topics_of(args: argparse.Namespace) -> TopicChoice:
    return TopicChoice(args.scan_topic, args.odometry_topic, args.imu_topic, args.wheels_topic)
