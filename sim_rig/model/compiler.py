"""Numba with the passes that the page needs, and no others: half of its time to compile.

The page is floats, loops, and calls: nothing to inline, to unroll, or to rewrite, and every name
has one type, so that LLVM may bring it into single assignment by itself. A custom pipeline is
numba's own way to say so (its manual, "Customizing the Compiler").
"""

from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core.compiler import CompilerBase
from numba.core.compiler_machinery import PassManager
from numba.core.typed_passes import (
    IRLegalization,
    NativeLowering,
    NoPythonBackend,
    NopythonTypeInference,
)
from numba.core.untyped_passes import FixupArgs, IRProcessing, TranslateByteCode


class PageCompiler(CompilerBase):
    """Bytecode, types, LLVM."""

    def define_pipelines(self) -> list[Any]:
        """The one pipeline."""
        passes = PassManager("page")
        passes.add_pass(TranslateByteCode, "bytecode")
        passes.add_pass(FixupArgs, "arguments")
        passes.add_pass(IRProcessing, "intermediate representation")
        passes.add_pass(NopythonTypeInference, "types")
        passes.add_pass(IRLegalization, "legal")
        passes.add_pass(NativeLowering, "LLVM")
        passes.add_pass(NoPythonBackend, "machine code")
        passes.finalize()
        return [passes]


# njit's stubs do not know every option.
_OPTIONS: Any = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "pipeline_class": PageCompiler,
}
_HELPER: Any = {**_OPTIONS, "no_cpython_wrapper": True}


def compiled_helper(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that only compiled ones call."""
    helper: Callable[..., Any] = njit(**_HELPER)(function)
    return helper


def compiled_run(function: Callable[..., Any], signature: str) -> Callable[..., Any]:
    """A function that Python calls, compiled or loaded from its cache at once."""
    run: Callable[..., Any] = njit(signature, **_OPTIONS)(function)
    return run
