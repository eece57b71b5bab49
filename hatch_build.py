"""Compile the kernels when a wheel is built, or installed in place: the first run finds them ready.

What is compiled serves the processor model, the Python and the numba that it was made with; where one of them differs, or where this
fails, the first run compiles.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class KernelBuildHook(BuildHookInterface):  # type: ignore[type-arg]
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version == "editable":
            self._compile(Path(self.root))
            return
        self._copy = Path(tempfile.mkdtemp(prefix="mfslam-kernels-"))
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(Path(self.root) / "mfslam", self._copy / "mfslam", ignore=ignored)
        self._compile(self._copy)
        compiled = [*(self._copy / "mfslam" / "kernels" / "__pycache__").glob("*.nb[ci]")]
        for file in compiled:
            build_data["force_include"][str(file)] = file.relative_to(self._copy).as_posix()
        if compiled:
            build_data["pure_python"], build_data["infer_tag"] = False, True

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        if version != "editable":
            shutil.rmtree(self._copy)

    def _compile(self, root: Path) -> None:
        """Compile into the kernels' own folder below ``root``."""
        kept = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
        child = subprocess.run(
            [sys.executable, "-m", "mfslam.kernels.warm_up"],
            cwd=root,
            env=kept,
            capture_output=True,
            text=True,
        )
        if child.returncode != 0:
            self.app.display_warning(
                f"kernels were not compiled, the first run will: {child.stderr.strip()[-500:]}"
            )
