"""What the README shows is run, and what it links to is there."""

import re
from pathlib import Path

from drivers.simulator import demo_simulation
from drivers.writers.log import write_log
from mfslam.settings import preset_names

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text("utf-8")
PYTHON = re.findall(r"```python\n(.*?)```", README, re.S)


def test_the_python_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    simulation = demo_simulation()
    half = simulation.messages[: len(simulation.messages) // 4]
    write_log(half, Path("robot.mcap"))
    code, _ = PYTHON
    exec(compile(code, "README.md", "exec"), {})
    stamp, *pose = capsys.readouterr().out.replace("[", " ").replace("]", " ").split()
    assert int(stamp) in simulation.truth_stamps_ns
    assert len(pose) == 3


def test_the_live_python_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    _, code = PYTHON
    assert len(code.strip().splitlines()) <= 13
    exec(compile(code, "README.md", "exec"), {})
    numbers = re.findall(r"-?\d+\.?\d*(?:e[-+]?\d+)?", capsys.readouterr().out)
    rows, columns, edges = map(int, numbers[-3:])
    assert len(numbers) == 3 + 9 + 3
    assert rows > 50 and columns > 50 and edges >= 0


def test_every_link_leads_somewhere():
    targets = re.findall(r"\]\(([^)#]+)\)", README)
    assert targets
    missing = [t for t in targets if not (ROOT / t).exists()]
    assert not missing


def test_every_preset_named_exists():
    named = re.findall(r"`([a-z0-9-]+)`", README.split("Sensor presets:")[1].split("\n\n")[0])
    assert set(named) <= set(preset_names())
    assert len(named) > 5
