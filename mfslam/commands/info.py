"""`mfslam info`: what a log holds and what is odd in it."""

from __future__ import annotations

import argparse

from drivers.inspect_log import describe_log
from mfslam.commands.settings import config_for, topics_of
from mfslam.output import check_writable, json_text, write_atomically


def run(args: argparse.Namespace) -> int:
    if args.json is not None:
        check_writable(args.json)
    description = describe_log(args.log, config_for(args.log, args), topics_of(args))
    if args.json is not None:
        write_atomically(args.json, json_text(description.as_json()).encode())
    print(description.text())
    return 0
