"""The commands as a user meets them: real processes where that matters, `main` elsewhere."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from short_logs import drive

from drivers.writers.log import write_log
from mfslam.cli import main
from mfslam.commands.interrupts import Interrupts
from mfslam.types import Scan

MFSLAM = [sys.executable, "-m", "mfslam.cli"]
RUN_FILES = {
    "config.yaml", "graph.g2o", "keyframes.tum", "map.pgm", "map.png", "map.yaml", "points.ply", "report.html",
    "summary.json", "trajectory.tum", "trajectory.cov",
}  # fmt: skip


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """150 scans of a simulated drive."""
    path = tmp_path_factory.mktemp("logs") / "short.mcap"
    messages = drive().messages
    end = [n for n, message in enumerate(messages) if isinstance(message, Scan)][150]
    write_log(messages[:end], path)
    return path


def test_help_answers_without_what_takes_long_to_load() -> None:
    said = "import sys; from mfslam.cli import main; main(['map', '--help'])"
    loaded = "import atexit, sys; atexit.register(lambda: print(*sys.modules, file=sys.stderr)); "
    child = subprocess.run([sys.executable, "-c", loaded + said], capture_output=True, text=True)
    assert child.returncode == 0 and "--overwrite" in child.stdout
    assert not {"gtsam", "numba", "rosbags", "scipy"} & set(child.stderr.split())


def test_without_a_command_the_help_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main([])
    assert left.value.code == 2
    assert "map a log: trajectory, factor graph" in capsys.readouterr().err


def test_map_leaves_all_files_and_says_where(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, extra = tmp_path / "new" / "out", tmp_path / "summary.json"
    assert main(["map", str(log), "-o", str(out), "--json", str(extra)]) == 0
    said = capsys.readouterr()
    assert {path.name for path in out.iterdir()} == RUN_FILES
    assert f"{out / 'map.png'}" in said.out and f"{out / 'report.html'}" in said.out
    summary = json.loads(extra.read_text())
    assert summary == json.loads((out / "summary.json").read_text())
    assert summary["counts"]["scans"] == 150 and not summary["interrupted"]
    assert summary["timings_s"]["total"] > 0.0 and summary["real_time_factor"] > 1.0
    quarters = summary["reading_cost_by_quarter"]
    assert len(quarters) == 4 and all(q["travelled_m"] > 0.0 and q["cpu_s"] > 0.0 for q in quarters)
    assert len(said.err.splitlines()) < 12, "no flood of lines where there is no terminal"
    assert "\r" not in said.err


def test_quiet_says_nothing(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["map", str(log), "-o", str(tmp_path / "out"), "-q"]) == 0
    assert capsys.readouterr() == ("", "")


def test_a_terminal_sees_a_bar_with_the_real_time_factor(log: Path, tmp_path: Path) -> None:
    here, there = pty.openpty()
    child = subprocess.Popen(
        [*MFSLAM, "map", str(log), "-o", str(tmp_path / "out")], stderr=there, stdout=subprocess.DEVNULL
    )
    os.close(there)
    shown = b""
    try:
        while piece := os.read(here, 4096):
            shown += piece
    except OSError:  # the other end is closed
        pass
    os.close(here)
    assert child.wait() == 0
    text = shown.decode()
    assert "mapping short.mcap 100 % |" in text and "x real time" in text
    assert "drawing the map ..." in text


@pytest.mark.parametrize(
    ("extra", "expected"),
    [
        (["--preset", "sick-lms20"], "did you mean sick-lms200?"),
        (["--preset", "nothing-like-it"], "Presets: conventional-icp, generic, motion-free-icp, rplidar-a1"),
        (["--set", "map.resolutin_m=1"], "--set map.resolutin_m=1: map.resolutin_m: no such setting; did you mean"),
        (["--set", "map.resolution_m=-1"], "map.resolution_m: Input should be greater than 0"),
        (["--set", "map.resolution_m"], "expected stage.key=value"),
        (["--config", "missing.yaml"], "missing.yaml: cannot be read: No such file or directory"),
        (["--scan-topic", "/nowhere"], "/nowhere"),
        (["--odometry-topic", "/nowhere"], "/nowhere"),
        (["--imu-topic", "/nowhere"], "/nowhere"),
        (["--wheels-topic", "/nowhere"], "/nowhere"),
    ],
)  # fmt: skip
def test_what_is_not_known_is_one_line(
    extra: list[str], expected: str, log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["map", str(log), "-o", str(tmp_path / "out"), *extra]) == 1
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1
    assert said.err.startswith("mfslam: ") and expected in said.err
    assert not (tmp_path / "out").exists()


def test_info_tells_what_a_log_holds(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(log), "--json", str(tmp_path / "info.json")]) == 0
    said = capsys.readouterr().out
    info = json.loads((tmp_path / "info.json").read_text())
    assert info["messages"]["Scan"] == 150 and info["format"] == "ros2"
    assert "150 scans of 721 beams" in said and "odd       " in said


def test_config_prints_what_it_accepts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "--preset", "urg-04lx", "--set", "map.resolution_m=0.02"]) == 0
    printed = capsys.readouterr().out
    assert "resolution_m: 0.02" in printed and '"urg-04lx"' in printed
    (tmp_path / "all.yaml").write_text(printed)
    assert main(["config", "--config", str(tmp_path / "all.yaml")]) == 0
    assert capsys.readouterr().out == printed


@pytest.mark.parametrize("command", ["info", "config"])
def test_a_reader_that_goes_away_is_no_error(command: str, log: Path) -> None:
    argument = [str(log)] if command == "info" else []
    here, there = os.pipe()
    os.close(here)
    child = subprocess.run([*MFSLAM, command, *argument], stdout=there, stderr=subprocess.PIPE, text=True)
    os.close(there)
    assert child.returncode == 141  # as by SIGPIPE
    assert child.stderr == ""


# --- Ctrl-C ------------------------------------------------------------------------------------------


def interrupt(command: list[str], word: str) -> tuple[int, str]:
    """Run a command and send SIGINT once a line of it holds ``word``; its status and what it said."""
    child = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    assert child.stderr is not None
    said = ""
    for line in child.stderr:
        if word in line and word not in said:
            child.send_signal(signal.SIGINT)
        said += line
    return child.wait(), said


@pytest.fixture(scope="module")
def long_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole drive: long enough to be interrupted."""
    path = tmp_path_factory.mktemp("logs") / "long.mcap"
    write_log(drive().messages, path)
    return path


AT_SCAN_200 = """
import os, signal, sys
from mfslam.cli import main
from mfslam.slam import Slam

feed = Slam.feed
def feed_until(self, message):
    feed(self, message)
    if len(self.scans) == 200:
        os.kill(os.getpid(), signal.SIGINT)
Slam.feed = feed_until
sys.exit(main(sys.argv[1:]))
"""


def test_ctrl_c_while_reading_leaves_the_map_so_far(long_log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-c", AT_SCAN_200, "map", str(long_log), "-o", str(out)]
    child = subprocess.run(command, capture_output=True, text=True)
    assert child.returncode == 130, child.stderr
    assert {path.name for path in out.iterdir()} == RUN_FILES
    summary = json.loads((out / "summary.json").read_text())
    assert summary["interrupted"] and summary["counts"]["scans"] == 201  # the last one read is placed, too
    assert "note: interrupted after" in child.stderr
    assert "interrupted" in [finding["code"] for finding in summary["findings"]]


def test_ctrl_c_while_refining_writes_the_map_as_it_is(long_log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    status, said = interrupt([*MFSLAM, "map", str(long_log), "-o", str(out)], "adjusting all keyframes")
    assert status == 130, said
    assert {path.name for path in out.iterdir()} == RUN_FILES
    summary = json.loads((out / "summary.json").read_text())
    assert summary["counts"]["scans"] == len(drive().scans)
    assert "not-refined" in [finding["code"] for finding in summary["findings"]]


def test_ctrl_c_before_the_first_scan_leaves_nothing(long_log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    status, said = interrupt([*MFSLAM, "map", str(long_log), "-o", str(out)], "mapping long.mcap")
    assert status == 130
    assert said.endswith("mfslam: interrupted: nothing was written\n") and "Traceback" not in said
    assert not out.exists()


def test_the_third_ctrl_c_breaks_off_at_once() -> None:
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), Interrupts() as interrupts:
        for count in (1, 2):
            os.kill(os.getpid(), signal.SIGINT)
            assert interrupts.count == count
        os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
