"""The viewer's process: ``python -m mfslam.viewer FD``, started by `client.Viewer`."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import suppress
from multiprocessing.connection import Connection

from mfslam.types import MfslamError
from mfslam.viewer.hub import Hub
from mfslam.viewer.place import Job
from mfslam.viewer.server import Server, Show


def main(fd: int) -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.set_inheritable(fd, False)
    line = Connection(fd)
    job: Job = line.recv()
    sending = threading.Lock()

    def ask(number: int) -> None:
        with sending, suppress(OSError):
            line.send(("save", number))

    hub = Hub(ask)
    try:
        server = Server(job.place, Show(hub, job.hello, download=job.folder, token=job.token))
    except MfslamError as error:
        line.send(("failed", str(error)))
        return 1
    threading.Thread(target=server.serve_forever, daemon=True).start()
    line.send(("ready", server.server_address[1]))
    _listen(line, hub)
    server.let_go()
    return 0


def _listen(line: Connection, hub: Hub) -> None:
    """States, answers and last words, until whoever sends them has gone."""
    with suppress(EOFError, OSError):
        while True:
            what, *more = line.recv()
            if what == "state":
                hub.show(hub.snapshot.followed_by(*more))
            elif what == "answer":
                hub.answered(*more)
            elif what == "over":
                hub.end(*more)


if __name__ == "__main__":
    status = main(int(sys.argv[1]))
    sys.stdout.flush()
    os._exit(status)  # a browser that does not read must not keep us
