"""`mfslam simulate` as a user meets it: every format, the truth beside it, and what is told when it cannot be."""

from __future__ import annotations

import re
import shlex
import signal
from pathlib import Path

import numpy as np
import pytest

from drivers.logs import default_presets, open_log
from drivers.simulator import HIT_KINDS, laser_model_names, load_world, world_names
from drivers.simulator.settings import describe, load_settings
from mfslam import se2
from mfslam.cli import main
from mfslam.metrics import associate, ate
from mfslam.output.tum import read_tum
from mfslam.settings import load, preset_path
from mfslam.types import Odometry, Scan, WheelAngles, WheelTicks

WORLD = """wall -3 -2 5 -2 5 4 -3 4 -3 -2
wall 1 4 1 2.5
box 3 3.2 1 0.6 20
pillar -1.5 2 0.2
glass 4 -1.5 4 -0.5
path -1 0
path 3 0.5
path 2 2
path -1 1
"""
DOCS = Path(__file__).resolve().parent.parent / "docs" / "simulator.md"


@pytest.fixture
def world(tmp_path: Path) -> str:
    path = tmp_path / "room.world"
    path.write_text(WORLD)
    return str(path)


def simulated(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Standard output of a run that ends well."""
    capsys.readouterr()
    assert main(["simulate", *map(str, arguments)]) == 0
    return capsys.readouterr().out


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """What is said of a run that cannot be: one line, exit status 1."""
    capsys.readouterr()
    assert main(["simulate", *map(str, arguments), "-q"]) == 1
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1
    return said.err


def map_command(said: str) -> list[str]:
    (line,) = re.findall(r"^map it  (.*)$", said, re.M)
    return shlex.split(line)


@pytest.mark.parametrize(
    ("name", "wheels"),
    [
        ("a.clf", Odometry),
        ("a.log.gz", Odometry),
        ("a.dat", WheelTicks),
        ("a.bag", Odometry),
        ("a.mcap", Odometry),
        ("a.db3", Odometry),
        ("folder", Odometry),
    ],
)
def test_every_format_reads_back_with_truth_at_every_scan(
    name: str, wheels: type, world: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / name
    said = simulated(capsys, world, "-o", log)
    with open_log(log, load([preset_path(p) for p in default_presets(log)])) as reader:
        messages = list(reader)
    scans = [m for m in messages if isinstance(m, Scan)]
    assert any(isinstance(m, wheels) for m in messages)
    stem = "folder" if name == "folder" else "a"
    stamps, poses = read_tum(tmp_path / f"{stem}.truth.tum")
    assert stamps.tolist() == [scan.stamp_ns for scan in scans]
    assert f"{len(scans)} scans" in said and len(poses) == len(scans)
    for line in (tmp_path / f"{stem}.relations").read_text().splitlines()[:20]:
        t1, t2, x, y, _, _, _, yaw = (float(field) for field in line.split())
        i, j = (int(np.argmin(np.abs(stamps * 1e-9 - t))) for t in (t1, t2))
        np.testing.assert_allclose(se2.between(poses[i], poses[j]), [x, y, yaw], atol=1e-8)
    left = {"room.world", name, f"{stem}.truth.tum", f"{stem}.relations"}
    assert {path.name for path in tmp_path.iterdir()} == left


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.dat", ["--mount", "0.1,0.02,5", "--set", "robot.wheels.swap_sides=true", "--set", "laser.scan_rate_hz=8"]),
        ("a.clf", ["--laser", "rplidar-a2", "--set", "laser.reversed_beams=true"]),
        ("a.mcap", ["--laser", "sick-lms200", "--set", "robot.odometry=ticks", "--mount", "0.1,0,0"]),
        ("b.mcap", ["--laser", "rplidar-a2"]),
    ],
)  # fmt: skip
def test_the_command_it_ends_with_maps_the_log_to_a_few_millimetres(
    name: str, options: list[str], world: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever the log cannot tell is in that command: mount, wheels, timing, sense of turning."""
    program, *arguments = map_command(simulated(capsys, world, "-o", tmp_path / name, *options))
    assert program == "mfslam" and main([*arguments, "-q"]) == 0
    true_stamps, truth = read_tum(tmp_path / f"{Path(name).stem}.truth.tum")
    stamps, poses = read_tum(tmp_path / f"{Path(name).stem}-map" / "trajectory.tum")
    i, j = associate(true_stamps, stamps)
    assert len(i) == len(true_stamps)
    error = ate(truth[i], poses[j])
    assert error.translation_m.rmse < 0.012 and error.rotation_deg.rmse < 0.5


def test_the_same_command_writes_the_same_bytes(
    world: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, seed in (("a.clf", 1), ("b.clf", 1), ("c.clf", 2)):
        simulated(capsys, world, "-o", tmp_path / name, "--seed", seed)
    a, b, c = ((tmp_path / f"{name}.clf").read_bytes() for name in "abc")
    assert a == b and a != c


def test_beam_truth_lies_on_the_walls(world: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    beams = tmp_path / "beams.npz"
    simulated(capsys, world, "-o", tmp_path / "a.mcap", "--beam-truth", beams, "--mount", "0.1,0,30")
    with np.load(beams) as data:
        poses, ranges, hits, stamps = data["world_T_laser"], data["range_m"], data["hit"], data["stamps_ns"]
        assert tuple(data["hit_kinds"]) == HIT_KINDS
    assert stamps.tolist() == read_tum(tmp_path / "a.truth.tum")[0].tolist()
    assert np.array_equal(hits == 0, np.isinf(ranges)) and ranges.shape == poses.shape[:2]
    bearings = np.radians(-180.0 + np.arange(ranges.shape[1]))
    heading = poses[..., 2] + bearings
    x, y = poses[..., 0] + ranges * np.cos(heading), poses[..., 1] + ranges * np.sin(heading)
    pillar = hits == HIT_KINDS.index("pillar")
    glass = hits == HIT_KINDS.index("glass")
    np.testing.assert_allclose(np.hypot(x[pillar] + 1.5, y[pillar] - 2.0), 0.2, atol=1e-9)
    np.testing.assert_allclose(x[glass], 4.0, atol=1e-9)
    assert pillar.any() and glass.any()


def test_lists_and_descriptions(tmp_path: Path, world: str, capsys: pytest.CaptureFixture[str]) -> None:
    listed = simulated(capsys, "--list")
    with pytest.raises(SystemExit):
        main(["simulate", "--help"])
    helped = "".join(capsys.readouterr().out.split())  # lines break within names
    for name in laser_model_names() + world_names():
        assert name in listed and name in helped
    printed = simulated(capsys, "--describe", "--laser", "urg-04lx", "--set", "faults.scan_gaps_s=[[1, 2]]")
    (tmp_path / "all.yaml").write_text(printed)
    assert simulated(capsys, "--describe", "--config", tmp_path / "all.yaml") == printed
    assert simulated(capsys, world, "--print-world") == WORLD
    (tmp_path / "office.world").write_text(simulated(capsys, "office:3:2", "--print-world"))
    np.testing.assert_array_equal(
        load_world(tmp_path / "office.world").segments, load_world("office:3:2").segments
    )


def test_every_setting_is_described() -> None:
    lines = describe().splitlines()
    for number, line in enumerate(lines):
        if ":" in line and not line.lstrip().startswith("#"):
            assert lines[number - 1].lstrip().startswith("# "), line


def test_speed_is_the_limit_where_the_world_states_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    slow = load_world("office:1:2", 0.5)
    assert set(slow.speeds_m_s) == {0.5}
    (tmp_path / "line.world").write_text("wall 0 3 40 3\npath 0 0\npath 40 0\n")
    seconds = []
    for speed in ("1", "2.5"):
        said = simulated(
            capsys, tmp_path / "line.world", "-o", tmp_path / "a.mcap", "--overwrite", "--speed", speed
        )
        seconds.append(int(re.findall(r"in (\d+) s", said)[0]))
    assert 40 < seconds[0] < 45 and 16 < seconds[1] < 21


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "expected a WORLD"),
        (["demo"], "expected -o LOG"),
        (["dem", "-o", "x.clf"], "did you mean demo?"),
        (["office:1:0", "-o", "x.clf"], "rooms and laps of at least 1"),
        (["office:a", "-o", "x.clf"], "expected office:SEED[:ROOMS[:LAPS]]"),
        (["demo", "-o", "x.txt"], "no log format known by this suffix"),
        (["demo", "-o", "x.clf", "--laser", "urg"], "no laser model 'urg'"),
        (["demo", "-o", "x.clf", "--robot", "track"], "did you mean tracks?"),
        (["demo", "-o", "x.clf", "--mount", "1,2"], "expected X,Y,YAW"),
        (["demo", "-o", "x.clf", "--seed", "-1"], "--seed -1"),
        (["demo", "-o", "x.clf", "--speed", "0"], "robot.max_speed_m_s: Input should be greater than or equal to 0.1"),
        (["demo", "-o", "x.clf", "--beam-truth", "x.clf"], "ends in .npz"),
        (["demo", "-o", "x.clf", "--set", "robot.acceleration=1"], "did you mean acceleration_m_s2?"),
        (["demo", "-o", "x.clf", "--set", "robot.wheels.track=1"], "did you mean track_m?"),
        (["demo", "-o", "x.clf", "--set", "fault.drop_share=1"], "did you mean faults?"),
        (["demo", "-o", "x.clf", "--set", "faults.drop_share=1"], "Input should be less than 1"),
        (["demo", "-o", "x.clf", "--set", "faults.scan_gaps_s=[[5, 3]]"], "expected [from, to] with from before to"),
        (["demo", "-o", "x.clf", "--set", "faults.drop_share"], "expected stage.key=value"),
        (["demo", "-o", "x.clf", "--set", "robot.gyro_bias_rad_s=.inf"], "finite number"),
        (["demo", "-o", "x.clf", "--set", "robot.wheels.left_joint=a"], "a simulated robot has none"),
        (["demo", "-o", "x.clf", "--set", "robot.compass_sigma_rad=0.1"], "set robot.gyro_rate_hz"),
        (["demo", "-o", "x.clf", "--set", "robot.odometry=ticks"], "a CARMEN log holds odometry poses"),
        (["demo", "-o", "x.clf", "--set", "laser.name=urg-04lx", "--set", "laser.range_max_m=0.01"],
         "expected more than the model's least range, 0.02 m"),
        (["demo", "-o", "x.dat", "--laser", "fast"], "682 beams"),
        (["demo", "-o", "x.clf", "--set", "faults.scan_gaps_s=[[0, 999]]"], "no scan fits"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_one_line_and_leaves_nothing(
    arguments: list[str], expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert expected in refused(capsys, *arguments)
    assert list(tmp_path.iterdir()) == []


def test_a_settings_file_is_blamed_by_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.yaml").write_text("laser:\n  name: fast\nfaults:\n  burst_scan: 2\n")
    said = refused(capsys, "demo", "-o", tmp_path / "x.clf", "--config", tmp_path / "bad.yaml")
    assert f"{tmp_path / 'bad.yaml'}:4: faults.burst_scan: no such setting; did you mean burst_scans?" in said


def test_what_exists_is_kept_or_replaced_as_told(
    world: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.truth.tum").write_text("mine")
    assert "a.truth.tum: exists already" in refused(capsys, world, "-o", tmp_path / "a.clf")
    assert (tmp_path / "a.truth.tum").read_text() == "mine" and not (tmp_path / "a.clf").exists()
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "photo").write_text("mine")
    assert "is a folder and no bag" in refused(capsys, world, "-o", tmp_path / "b", "--overwrite")
    simulated(capsys, world, "-o", tmp_path / "a.clf", "--overwrite")
    assert (tmp_path / "a.truth.tum").read_text() != "mine"
    for _ in range(2):  # a bag folder is replaced as a whole
        simulated(capsys, world, "-o", tmp_path / "bag", "--overwrite")
    assert sorted(p.name for p in (tmp_path / "bag").iterdir()) == ["bag.mcap", "metadata.yaml"]


def test_a_place_that_cannot_be_written_is_told_before_the_work(
    world: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(capsys, world, "-o", Path(world) / "a.clf")
    assert "cannot be written" in said


def test_ctrl_c_leaves_nothing(
    world: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Between the log and its truth: neither is there, nor the folder that was made for them."""
    import mfslam.commands.simulate as command

    monkeypatch.setattr(command, "write_tum", lambda *_: signal.raise_signal(signal.SIGINT))
    before = set(tmp_path.iterdir())
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)  # in a background job it is ignored
    try:
        assert main(["simulate", world, "-o", str(tmp_path / "new" / "a.clf")]) == 130
    finally:
        signal.signal(signal.SIGINT, handler)
    assert "interrupted: nothing was written" in capsys.readouterr().err
    assert set(tmp_path.iterdir()) == before


def test_the_angles_of_a_bag_are_mapped_with_the_told_wheels(
    world: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = simulated(
        capsys, world, "-o", tmp_path / "a.mcap", "--robot", "tracks", "--set", "robot.odometry=angles"
    )
    with open_log(tmp_path / "a.mcap", load()) as reader:
        assert any(isinstance(m, WheelAngles) for m in reader)
    wheels = load_settings("tracks").robot.wheels
    assert f"wheels.track_m={wheels.track_m:g}" in map_command(said)


def test_the_example_of_the_page_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its second command is indeed what the first one ends with."""
    text = DOCS.read_text("utf-8").split("<!-- example: begin -->")[1].split("<!-- example: end -->")[0]
    monkeypatch.chdir(tmp_path)
    (world,) = re.findall(r"<<END\n(.*?)END\n", text, re.S)
    Path("flat.world").write_text(world)
    simulate, map_it = re.findall(r"^mfslam (.*)$", text, re.M)
    assert map_command(simulated(capsys, *shlex.split(simulate)[1:])) == ["mfslam", *shlex.split(map_it)]
