"""Every kernel that a run uses is compiled, for its types, by the warm-up: nothing compiles in mid-run."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from drivers.simulator import RobotModel, laser_model, load_world, simulate
from drivers.writers.log import write_log
from mfslam.kernels import warm_up

# in a process of its own: other tests call kernels with other types
CHILD = """
import json, sys
from mfslam.cli import main
from mfslam.kernels import warm_up

def signatures():
    return {f"{k.__module__}.{k.__name__}": len(k.signatures) for k in warm_up._kernels()}

warm_up.call_all()
before = signatures()
log, out = sys.argv[1:]
assert main(["map", log, "-o", out, "-q"]) == 0
assert main(["map", log, "-o", out, "-q", "--overwrite", "--set", "icp.method=point_to_point",
             "--set", "deskew.mode=range"]) == 0
print(json.dumps([before, signatures()]))
"""


def test_a_run_compiles_nothing_that_the_warm_up_did_not(tmp_path: Path) -> None:
    log = tmp_path / "short.mcap"
    simulation = simulate(load_world("demo"), RobotModel(), laser_model("fast"), seed=1)
    write_log(simulation.messages[:1500], log)
    child = subprocess.run(
        [sys.executable, "-c", CHILD, str(log), str(tmp_path / "out")], capture_output=True, text=True
    )
    assert child.returncode == 0, child.stderr
    before, after = json.loads(child.stdout)
    assert not [name for name, count in before.items() if count == 0], "not called by the warm-up"
    assert after == before


def test_nothing_is_said_once_all_is_compiled() -> None:
    warm_up.call_all()
    said: list[str] = []
    assert warm_up.compile_once(said.append) == 0.0
    assert said == []
