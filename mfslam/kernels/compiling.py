"""What numba is told of every kernel, so that they are compiled once, in as little time as may be."""

import contextlib
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit
from numba.core import typed_passes, untyped_passes
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager

# The rules for scalars and arrays, before those for text, sets and dictionaries: numba tries them at every statement
# in the order of their import.
from numba.core.typing import arraydecl, builtins, collections

RULES = (builtins, collections, arraydecl)

_SPARED = {
    untyped_passes.WithLifting,
    untyped_passes.InlineClosureLikes,
    untyped_passes.DeadBranchPrune,
    untyped_passes.RewriteDynamicRaises,
    untyped_passes.MakeFunctionToJitFunction,
    untyped_passes.InlineInlinables,
    untyped_passes.FindLiterallyCalls,
    untyped_passes.LiteralUnroll,
    untyped_passes.LiteralPropagationSubPipelinePass,
    typed_passes.InlineOverloads,
    typed_passes.NopythonRewrites,
    typed_passes.DumpParforDiagnostics,
}


class KernelCompiler(CompilerBase):  # type: ignore[misc]  # numba is untyped
    """numba's own passes, without those for what no kernel has (closures, exceptions, ``with``, loops over tuples of
    unlike types), and without fusing expressions of whole arrays."""

    def define_pipelines(self) -> list[PassManager]:
        passes = PassManager("kernel")
        for each, description in DefaultPassBuilder.define_nopython_pipeline(self.state).passes:
            if each not in _SPARED:
                passes.add_pass(each, description)
        passes.finalize()
        return [passes]


# A quotient by zero is inf or nan, as in numpy, and raises nothing: no branches for that. Nothing in C calls a kernel:
# no wrapper for that. All alike, since numba compiles its own functions (np.zeros, max) anew for every set of options.
_OPTIONS = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "pipeline_class": KernelCompiler,
}

_SOURCES = hashlib.sha256(
    b"".join(file.read_bytes() for file in sorted(Path(__file__).parent.glob("*.py")))
).digest()


def kernel(function: Callable[..., Any]) -> Any:
    """What Python calls: compiled once, and kept on disk as long as no source of this room changes (by itself, numba looks
    at a kernel's own file, and not at those of the helpers that it was compiled with)."""
    compiled = njit(cache=True, **_OPTIONS)(function)
    with contextlib.suppress(AttributeError):  # a numba that keeps it elsewhere
        compiled._cache._cache_file._source_stamp = _SOURCES
    return compiled


helper = njit(**_OPTIONS)  # what kernels call: compiled with them, and kept with them
