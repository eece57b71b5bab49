"""Where a viewer is served, and what to type into a browser to see it."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PORT = 8765


@dataclass(frozen=True)
class Place:
    """``port`` 0 takes any that is free. ``bind``: 127.0.0.1 lets nobody in from other machines."""

    port: int = PORT
    bind: str = "127.0.0.1"

    @property
    def local(self) -> bool:
        return self.bind in ("127.0.0.1", "::1", "localhost")


@dataclass(frozen=True)
class Job:
    """What the viewer's process is told to do. ``folder``: where maps are saved."""

    place: Place
    token: str
    hello: dict[str, Any]
    folder: Path


def address(place: Place, token: str) -> str:
    """The page's address; ``token`` lets in whoever knows it."""
    host = _this_machine() if place.bind in ("0.0.0.0", "::", "") else place.bind
    return f"http://{f'[{host}]' if ':' in host else host}:{place.port}/{f'{token}/' if token else ''}"


def _this_machine() -> str:
    """The address by which others reach this machine, as the route outwards tells; nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
            return str(probe.getsockname()[0])
        except OSError:
            return socket.gethostname()
