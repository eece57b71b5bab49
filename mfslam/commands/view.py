"""`mfslam view`: a finished run in the viewer, with its time at hand."""

from __future__ import annotations

import argparse
import secrets
import sys
from dataclasses import replace

from mfslam.types import MfslamError
from mfslam.viewer.place import PORT, Place, address
from mfslam.viewer.run import show_run
from mfslam.viewer.server import Server


def run(args: argparse.Namespace) -> int:
    if not args.run_folder.is_dir():
        raise MfslamError(f"{args.run_folder}: expected a folder of `mfslam map`")
    place = place_of(args)
    if not args.quiet:
        print(f"reading {args.run_folder} ...", file=sys.stderr)
    show = show_run(args.run_folder)
    show.token = "" if place.local else secrets.token_urlsafe(12)
    with Server(place, show) as server:
        place = replace(place, port=server.server_address[1])
        print(f"open {address(place, show.token)} in a browser (Ctrl-C ends it)", flush=True)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            return 0
    return 0


def place_of(args: argparse.Namespace) -> Place:
    """Where ``--view`` and ``--view-bind`` want the viewer. Raises MfslamError."""
    port = PORT if args.view is None else args.view
    if not 0 <= port <= 65535:
        raise MfslamError(f"port {port} for the page: expected one from 0 (any that is free) to 65535")
    return Place(port, args.view_bind)
