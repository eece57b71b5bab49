"""`mfslam info`: what a log holds and what is odd in it."""

from __future__ import annotations

import argparse

from drivers.inspect_log import describe_log
from mfslam.commands.settings import config_for, topics_of
from mfslam.output import json_text, write_atomically


def run(args: argparse.Namespace) -> int:
    description = describe_log(args.log, config_for(args.log, args), topics_of(args))
    print(description.text())
    if args.json is not None:
        write_atomically(args.json, json_text(description.as_json()).encode())
    return 0
