"""Every kernel that a run uses is compiled, for its types, by the warm-up: nothing compiles in mid-run."""

from __future__ import annotations

import json
import os
import shutil
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


def test_kernels_older_than_a_helper_of_theirs_are_compiled_anew(tmp_path: Path) -> None:
    """numba itself looks at a kernel's own file alone."""
    package = Path(warm_up.__file__).parent
    shutil.copytree(package.parent, tmp_path / "mfslam", ignore=shutil.ignore_patterns("__pycache__"))
    code = """
import sys
import numpy as np
from mfslam.kernels import poses, warm_up
if sys.argv[1:]:
    poses.compose(np.zeros(3), np.zeros(3))
    poses.compose.overloads.clear()
print(warm_up.__file__, warm_up._is_cached(poses.compose))
"""

    def is_cached(*arguments: str) -> str:
        child = subprocess.run(
            [sys.executable, "-c", code, *arguments], capture_output=True, text=True, cwd=tmp_path, check=True,
            env=os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        )  # fmt: skip
        where, answer = child.stdout.split()
        assert Path(where).is_relative_to(tmp_path)
        return answer

    assert is_cached() == "False"
    assert is_cached("call") == "True"
    assert is_cached() == "True"
    with (tmp_path / "mfslam" / "kernels" / "matrices.py").open("a") as helpers:
        helpers.write("# changed\n")
    assert is_cached() == "False"
