"""Over real sockets: who is let in, who sees what, and that nobody is kept waiting by anybody."""

from __future__ import annotations

import io
import json
import os
import signal
import socket
import threading
import time
import urllib.error
import urllib.request
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import room, state

from mfslam.output import read_map
from mfslam.output.maps import grid_image, pgm_bytes, yaml_text
from mfslam.types import MfslamError
from mfslam.viewer import client
from mfslam.viewer.client import Viewer
from mfslam.viewer.hub import Hub
from mfslam.viewer.place import Place, address
from mfslam.viewer.server import Server, Show
from mfslam.viewer.snapshot import Snapshot

ANY = Place(0)


@contextmanager
def serving(show: Show, place: Place = ANY) -> Iterator[str]:
    with Server(place, show) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield address(Place(server.server_address[1], "127.0.0.1"), show.token)
        server.shutdown()


def get(url: str, data: bytes | None = None, **headers: str) -> tuple[int, bytes]:
    request = urllib.request.Request(url, data, {k.replace("_", "-"): v for k, v in headers.items()})
    try:
        with urllib.request.urlopen(request, timeout=10) as reply:
            return reply.status, reply.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


def events(url: str, seconds: float = 20.0) -> Iterator[dict[str, Any]]:
    with urllib.request.urlopen(f"{url}events", timeout=seconds) as stream:
        for line in stream:
            if line.startswith(b"data: "):
                yield json.loads(line[6:])


def first_with(url: str, key: str) -> Any:
    return next(event[key] for event in events(url) if key in event)


def hub_with(k: int = 5) -> Hub:
    hub = Hub()
    hub.show(Snapshot().followed_by(state(k, room())))
    return hub


# --- who is let in ------------------------------------------------------------------------------------


def test_only_those_who_know_the_token_are_let_in() -> None:
    with serving(Show(hub_with(), {"mode": "live"}, token="s3cret"), Place(0, "0.0.0.0")) as url:
        outside = url.removesuffix("s3cret/")
        assert get(url)[0] == 200 and get(f"{url}main.js")[0] == 200
        for path in ("", "events", "main.js", "tiles/0_0", "s3cre/", "s3cret0/events", "save"):
            assert get(outside + path)[0] == 403
        assert get(f"{outside}s3cret")[0] == 200  # led on to the one with the slash
        assert first_with(url, "robot")["pose"][0] == pytest.approx(-0.75)


@pytest.mark.parametrize(
    ("host", "status"), [("localhost:{}", 200), ("127.0.0.1:{}", 200), ("[::1]:{}", 200), ("evil.example:{}", 403)]
)  # fmt: skip
def test_a_name_of_another_site_that_leads_here_is_refused(host: str, status: int) -> None:
    with serving(Show(hub_with(), {})) as url:
        assert get(url, Host=host.format(url.rsplit(":", 1)[1].strip("/")))[0] == status


def test_a_page_of_another_site_cannot_save() -> None:
    wishes: list[int] = []
    with serving(Show(Hub(wishes.append), {})) as url:
        assert get(f"{url}save", b"")[0] == 404
    assert not wishes


def test_nothing_but_the_page_is_served() -> None:
    with serving(Show(hub_with(), {})) as url:
        for path in (
            "../server.py",
            "%2e%2e/server.py",
            "page/main.js",
            "viewer.py",
            "map.zip",
            "tiles/9_9",
            "tiles/x",
        ):
            assert get(url + path)[0] == 404
        with urllib.request.urlopen(url) as reply:
            assert "default-src 'self'" in reply.headers["Content-Security-Policy"]


def test_a_port_that_is_taken_is_told_in_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(MfslamError, match=f"port {port}: address already in use; name another one"):
            Server(Place(port), Show(Hub(), {}))


# --- who sees what ------------------------------------------------------------------------------------


def test_one_who_comes_late_sees_everything() -> None:
    hub = hub_with(0)
    for k in range(1, 30):
        hub.show(hub.snapshot.followed_by(state(k)))
    with serving(Show(hub, {"mode": "live"})) as url:
        stream = events(url)
        assert next(stream) == {"hello": {"mode": "live"}}
        told = next(stream)
        assert told["path"]["from"] == 0 and len(told["map"]["tiles"]) == 4
        assert told["robot"]["pose"][0] == pytest.approx(0.45)
        assert get(f"{url}tiles/{next(iter(told['map']['tiles']))}")[0] == 200


def test_one_who_does_not_read_holds_up_nobody() -> None:
    """A browser that asks for the stream and then reads nothing, while 3 MB of scans pass."""
    hub = hub_with()
    with serving(Show(hub, {})) as url:
        port = int(url.rsplit(":", 1)[1].strip("/"))
        stalled = socket.create_connection(("127.0.0.1", port))
        stalled.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        reader = events(url)
        next(reader)
        slowest_s = 0.0
        for k in range(6, 60):
            began_s = time.perf_counter()
            hub.show(hub.snapshot.followed_by(state(k * 100)))
            slowest_s = max(slowest_s, time.perf_counter() - began_s)
            time.sleep(0.02)
        newest = next(e["robot"]["stamp_s"] for e in reader if e.get("robot", {}).get("pose", [0])[0] > 290)
        stalled.close()
    assert newest == pytest.approx(state(5900).stamp_ns * 1e-9)
    assert slowest_s < 1.0  # it only has to be much less than the patience with the stalled one


def test_the_downloaded_map_loads(tmp_path: Path) -> None:
    grid = room()
    (tmp_path / "map.yaml").write_text(yaml_text(grid))
    (tmp_path / "map.pgm").write_bytes(pgm_bytes(grid_image(grid)))
    with serving(Show(hub_with(), {}, download=tmp_path)) as url:
        zipfile.ZipFile(io.BytesIO(get(f"{url}map.zip")[1])).extractall(tmp_path / "copy")
    np.testing.assert_array_equal(read_map(tmp_path / "copy" / "map.yaml").occupancy, grid.occupancy)


# --- its process --------------------------------------------------------------------------------------


def test_a_wish_to_save_is_answered_and_a_killed_viewer_comes_back(tmp_path: Path) -> None:
    with Viewer(ANY, "robot", tmp_path) as viewer:
        viewer.show(state(9, room()))
        assert first_with(viewer.url, "hello") == {"mode": "live", "title": "robot", "save": True}
        answers: list[bytes] = []
        asking = threading.Thread(
            target=lambda: answers.append(get(f"{viewer.url}save", b"", X_Mfslam="1")[1])
        )
        asking.start()
        wish = wait_for(viewer.wish)
        viewer.answer(wish, text="written to OUT/")
        asking.join(10)
        assert json.loads(answers[0]) == {"text": "written to OUT/"}
        os.kill(viewer.process.pid, signal.SIGKILL)
        wait_for(lambda: viewer.restarts == 1 and "started again; mapping went on" in (viewer.trouble or ""))
        assert "SIGKILL" in (viewer.trouble or "")
        # at the same address, and with all there was, though nothing new has come
        assert len(first_with(viewer.url, "map")["tiles"]) == 4


def test_a_viewer_that_is_killed_during_the_final_solve_still_says_that_it_is_solved(tmp_path: Path) -> None:
    with Viewer(ANY, "robot", tmp_path) as viewer:
        viewer.show(state(9, room()))
        viewer.end("solving the whole map", last=False)
        assert first_with(viewer.url, "over") == "solving the whole map"
        os.kill(viewer.process.pid, signal.SIGKILL)
        wait_for(lambda: viewer.restarts == 1 and "started again; mapping went on" in (viewer.trouble or ""))
        told = next(event for event in events(viewer.url) if "over" in event)
        assert told["over"] == "solving the whole map" and not told["last"]
        viewer.end("saved", last=True)
        assert any(event.get("over") == "saved" and event["last"] for event in events(viewer.url))


def test_an_answer_to_a_browser_of_a_viewer_that_has_died_reaches_no_other(tmp_path: Path) -> None:
    with Viewer(ANY, "robot", tmp_path) as viewer:
        said: list[bytes] = []

        def save() -> None:
            with suppress(OSError):
                said.append(get(f"{viewer.url}save", b"", X_Mfslam="1")[1])

        threading.Thread(target=save, daemon=True).start()
        first = wait_for(viewer.wish)
        os.kill(viewer.process.pid, signal.SIGKILL)
        wait_for(lambda: viewer.restarts == 1 and "started again; mapping went on" in (viewer.trouble or ""))
        viewer.answer(first, text="late")
        threading.Thread(target=save, daemon=True).start()
        second = wait_for(viewer.wish)
        viewer.answer(second, text="now")
        assert json.loads(wait_for(lambda: said)[-1]) == {"text": "now"}


def test_a_viewer_that_hangs_holds_up_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "LEAVE_S", 0.3)
    viewer = Viewer(ANY, "robot", tmp_path)
    os.kill(viewer.process.pid, signal.SIGSTOP)
    grid = room(60.0)  # more than any buffer of a socket takes
    began_s = time.monotonic()
    for k in range(100):
        viewer.show(state(k, grid))
        time.sleep(0.005)
    assert time.monotonic() - began_s < 5.0
    viewer.close()
    assert viewer.process.end() == -signal.SIGKILL


def test_the_viewer_ends_with_whoever_started_it(tmp_path: Path) -> None:
    code = (
        "import os, sys; from pathlib import Path; from mfslam.viewer.client import Viewer\n"
        "from mfslam.viewer.place import Place\n"
        "print(Viewer(Place(0), 'robot', Path(sys.argv[1])).process.pid, flush=True); os.kill(os.getpid(), 9)"
    )
    import subprocess
    import sys

    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False
    )
    viewer = int(done.stdout)
    wait_for(lambda: not _runs(viewer))


def _runs(pid: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_for(what: Any, timeout_s: float = 20.0) -> Any:
    end_s = time.monotonic() + timeout_s
    while not (value := what()):
        assert time.monotonic() < end_s, "it does not come"
        time.sleep(0.02)
    return value


def test_the_engine_never_imports_gtsam_for_the_viewer() -> None:
    import subprocess
    import sys

    code = "import sys, mfslam.viewer.__main__, mfslam.viewer.client; sys.exit('gtsam' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, env=dict(os.environ)).returncode == 0
