"""`mfslam config`: every setting, with its unit and meaning."""

from __future__ import annotations

import argparse

from mfslam.settings import describe, load, preset_path


def run(args: argparse.Namespace) -> int:
    files = [preset_path(name) for name in args.preset] + ([args.config] if args.config else [])
    print(describe(load(files, args.settings)))
    return 0
