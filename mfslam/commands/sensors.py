"""What the commands that read live sensors share."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

from drivers.acquisition.sources import Sources
from mfslam.config import Config
from mfslam.settings import load, preset_path
from mfslam.types import MfslamError


def sources_of(args: argparse.Namespace) -> Sources:
    """The sensors that are named. Raises MfslamError."""
    if args.duration is not None and not args.duration > 0.0:
        raise MfslamError(f"--duration {args.duration:g}: expected more than 0 s")
    return Sources(args.lidar, args.wheels)


def config_of(args: argparse.Namespace, brought: list[str] | None = None) -> Config:
    """Layers: settings that the sensors bring (``brought``), --preset, --config, --set. Raises MfslamError."""
    files = [preset_path(name) for name in args.preset] + ([args.config] if args.config else [])
    return load(files, args.settings, otherwise=brought or [])


def map_command(args: argparse.Namespace, sources: Sources, recording: Path, folder: Path) -> str:
    """What maps the recording offline, with the settings that it needs."""
    command = ["mfslam", "map", str(recording), "-o", str(folder)]
    command += [word for name in args.preset for word in ("--preset", name)]
    command += ["--config", str(args.config)] if args.config else []
    config = config_of(args, sources.map_settings())
    brought = [text for text in sources.map_settings() if _holds(text, config)]
    command += [word for text in [*brought, *args.settings] for word in ("--set", text)]
    return shlex.join(command)


def _holds(setting: str, config: Config) -> bool:
    """Whether nobody has said anything else than this number."""
    key, _, value = setting.partition("=")
    stage, name = key.split(".")
    return bool(getattr(getattr(config, stage), name) == float(value))
