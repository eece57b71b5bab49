"""Compiled inner loops: arrays in, arrays out, no classes, no checks (their callers check).

Poses are (x, y, theta) scalars or arrays; every kernel that Python calls releases the GIL and is cached on
disk, so the compilation is paid once per installation (``@kernel``; `compiling` says how). What only kernels call is a
``@helper``: LLVM puts the small ones in their places by itself, where inline="always" compiles them anew in every one
(and, where they take arrays, leaves counts of references in the innermost loops).
"""

import os
import sys
import tempfile
from pathlib import Path


def _find_cache_folder() -> None:
    """numba refuses even to load where neither this folder nor the user's own can hold its cache (a system
    user without a home, say): give it one among the temporary files."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        return
    own = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111
    if _can_hold(Path(__file__).parent / "__pycache__") or (own[:1] != "~" and _can_hold(Path(own))):
        return
    folder = Path(tempfile.gettempdir()) / f"mfslam-kernels-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        ours = folder.lstat().st_uid == os.getuid() and folder.is_dir()
    except OSError:
        ours = False
    cache = str(folder) if ours else tempfile.mkdtemp(prefix="mfslam-kernels-")
    os.environ["NUMBA_CACHE_DIR"] = cache
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = cache


def _can_hold(folder: Path) -> bool:
    """Whether files can be made in a folder, or the folder itself where it is missing."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return os.access(folder, os.W_OK | os.X_OK)


_find_cache_folder()
