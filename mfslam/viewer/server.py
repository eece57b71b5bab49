"""HTTP for browsers: the page, tiles, a stream of what is new, and the wish to save.

Only the standard library, on purpose (docs/live.md). Each browser has a thread of its own here, so that one that
does not read holds up nobody but itself.
"""

from __future__ import annotations

import io
import json
import socket
import sys
import time
import zipfile
from dataclasses import dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from secrets import compare_digest
from typing import Any
from urllib.parse import parse_qs, urlsplit

from mfslam.types import MfslamError
from mfslam.viewer.hub import Hub
from mfslam.viewer.place import Place
from mfslam.viewer.snapshot import Has, news

LEAST_STEP_S = 0.06  # between two events to one browser
HEARTBEAT_S = 1.0
FAREWELL_S = 1.0
PATIENCE_S = 20.0  # with a browser that does not read
MOST_BROWSERS = 50
SEND_BUFFER_BYTES = 65_536  # what a slow line holds back is stale: little of it
LOCAL_NAMES = {"localhost", "127.0.0.1", "[::1]"}
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
HEADERS = {
    # nothing from outside, whatever the page would like
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data: blob:; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


@dataclass
class Show:
    """What is served. ``hello``: JSON-able, the first thing that a browser is told. ``run``: binary parts of a
    finished run, by name. ``download``: folder whose map.yaml and image are offered."""

    hub: Hub
    hello: dict[str, Any]
    run: dict[str, Any] = field(default_factory=dict)
    download: Path | None = None
    token: str = ""


class Server(ThreadingHTTPServer):
    """Listens at a place. Raises MfslamError in one line where it cannot."""

    daemon_threads = True
    request_queue_size = 64

    def __init__(self, place: Place, show: Show) -> None:
        self.show = show
        self.browsers = 0
        self.local = place.local
        self.address_family = socket.AF_INET6 if ":" in place.bind else socket.AF_INET
        try:
            super().__init__((place.bind, place.port), Handler)
        except (OSError, OverflowError) as error:
            why = (getattr(error, "strerror", None) or str(error)).lower()
            raise MfslamError(
                f"the viewer cannot listen at {place.bind}, port {place.port}: {why}; name another one, or port 0 "
                "for any that is free"
            ) from None

    def let_go(self) -> None:
        """Every browser is told the last there is, unless it does not read."""
        self.show.hub.close()
        end_s = time.monotonic() + FAREWELL_S
        while self.browsers and time.monotonic() < end_s:
            time.sleep(0.01)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that has gone is no news; anything else is a fault of ours and is told."""
        error = sys.exc_info()[1]
        if not isinstance(error, OSError):
            print(f"viewer: {type(error).__name__}: {error}", file=sys.stderr, flush=True)


class Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "mfslam", ""
    timeout = PATIENCE_S

    def setup(self) -> None:
        super().setup()
        self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are nobody's business."""

    # --- requests -------------------------------------------------------------------------------------

    def do_GET(self) -> None:
        name = self._let_in()
        if name is None:
            return
        if name == "events":
            self._events()
        elif name.startswith("tiles/"):
            self._tile(name.removeprefix("tiles/"))
        elif name == "map.zip":
            self._download()
        elif name in self.server.show.run:
            self._run_part(name)
        else:
            self._page(name or "index.html")

    def do_POST(self) -> None:
        name = self._let_in()
        if name is None:
            return
        # a page of another site cannot send this header without asking us first
        if name != "save" or self.headers.get("X-Mfslam") is None:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        self.rfile.read(min(int(self.headers.get("Content-Length") or 0), 4096))
        self._json(self.server.show.hub.save())

    def _let_in(self) -> str | None:
        """The name of what is asked for, below the token; None, answered, for those who are not let in."""
        path, show = urlsplit(self.path).path, self.server.show
        first, slash, rest = path.removeprefix("/").partition("/")
        if show.token:
            if not compare_digest(first.encode(), show.token.encode()):
                self._refuse(
                    HTTPStatus.FORBIDDEN, "the address lacks its token: take it as mfslam printed it"
                )
                return None
            if not slash:  # relative addresses on the page need it
                self.send_response(HTTPStatus.MOVED_PERMANENTLY)
                self.send_header("Location", f"/{show.token}/")
                self.send_header("Content-Length", "0")
                self.end_headers()
                return None
            return rest
        host = (self.headers.get("Host") or "").rpartition(":")
        name = host[0] if host[0] and host[2].isdigit() else "".join(host)
        if self.server.local and name not in LOCAL_NAMES:  # another site's name that leads here
            self._refuse(HTTPStatus.FORBIDDEN, "this page is for this machine only: see --view-bind")
            return None
        return path.removeprefix("/")

    # --- replies --------------------------------------------------------------------------------------

    def _reply(self, data: bytes, kind: str, more: dict[str, str] | None = None) -> None:
        self.send_response(HTTPStatus.OK)
        for key, value in (HEADERS | {"Cache-Control": "no-store"} | (more or {})).items():
            self.send_header(key, value)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def _json(self, value: Any) -> None:
        self._reply(json.dumps(value).encode(), "application/json")

    def _refuse(self, status: HTTPStatus, text: str = "") -> None:
        data = (text or status.phrase).encode()
        self.send_response(status)
        self.send_header("Content-Type", "text/plain; charset=utf-8")
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(data)
        self.close_connection = True

    def _page(self, name: str) -> None:
        suffix = Path(name).suffix
        found = files("mfslam.viewer").joinpath("page", name)
        if "/" in name or suffix not in TYPES or not found.is_file():
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        self._reply(found.read_bytes(), TYPES[suffix], {"Cache-Control": "no-cache"})

    def _tile(self, name: str) -> None:
        try:
            col, row = map(int, name.split("_"))
        except ValueError:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        tile = self.server.show.hub.snapshot.map.tiles.get((col, row))
        if tile is None:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        self._reply(tile.packed(), "application/octet-stream", {"Content-Encoding": "gzip"})

    def _run_part(self, name: str) -> None:
        """A part of a finished run; one that is made on demand takes its arguments from the query."""
        part = self.server.show.run[name]
        if callable(part):
            query = parse_qs(urlsplit(self.path).query)
            try:
                part = part(**{key: int(values[0]) for key, values in query.items()})
            except (ValueError, TypeError):
                self._refuse(HTTPStatus.BAD_REQUEST)
                return
        self._reply(part, "application/octet-stream")

    def _download(self) -> None:
        """map.yaml and its image, as they lie on disk, in one file."""
        folder = self.server.show.download
        packed = None if folder is None else map_zip(folder)
        if packed is None:
            self._refuse(HTTPStatus.NOT_FOUND, "no map has been written yet")
            return
        name = f"mfslam-map-{time.strftime('%Y%m%d-%H%M%S')}.zip"
        self._reply(packed, "application/zip", {"Content-Disposition": f'attachment; filename="{name}"'})

    # --- the stream -----------------------------------------------------------------------------------

    def _events(self) -> None:
        if self.server.browsers >= MOST_BROWSERS:
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, f"{MOST_BROWSERS} browsers look on already")
            return
        self.server.browsers += 1
        try:
            self.send_response(HTTPStatus.OK)
            for key, value in (HEADERS | {"Cache-Control": "no-store"}).items():
                self.send_header(key, value)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Connection", "close")
            self.end_headers()
            self._tell_news()
        finally:
            self.server.browsers -= 1
            self.close_connection = True

    def _tell_news(self) -> None:
        """Until the browser goes: at once all there is, then what differs from what it has."""
        show, has, number = self.server.show, Has(), -1
        self._event({"hello": show.hello})
        closing = False
        while not closing:
            number, snapshot = show.hub.newest(number, HEARTBEAT_S)
            closing = show.hub.closing
            event = news(snapshot, has)
            event["browsers"] = self.server.browsers
            if show.hub.over is not None:
                event |= {"over": show.hub.over, "last": show.hub.last}
            self._event(event)
            time.sleep(LEAST_STEP_S)

    def _event(self, value: dict[str, Any]) -> None:
        self.wfile.write(
            b"data: " + json.dumps(value, allow_nan=False, separators=(",", ":")).encode() + b"\n\n"
        )


def map_zip(folder: Path) -> bytes | None:
    """map.yaml and the image that it names; None where there is no map."""
    yaml = folder / "map.yaml"
    try:
        text = yaml.read_text(encoding="utf-8")
        image = text.splitlines()[0].removeprefix("image:").strip()
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("map.yaml", text)
            archive.writestr(image, (folder / image).read_bytes())
        return out.getvalue()
    except (OSError, UnicodeDecodeError, IndexError):
        return None
