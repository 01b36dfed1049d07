"""Numba with the passes that the page needs, and no others: a third of its time to compile.

The page is floats, loops, and calls: nothing to inline, to unroll, or to rewrite, and every name
has one type, so that LLVM may bring it into single assignment by itself. Its arrays are the
caller's, and nothing counts references to them. What `float * float` is, is asked once and not a
thousand times. A custom pipeline is numba's own way to say so (its manual, "Customizing the
Compiler").
"""

from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core.compiler import CompilerBase
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.lowering import Lower
from numba.core.typed_passes import NativeLowering, NoPythonBackend, NopythonTypeInference
from numba.core.untyped_passes import FixupArgs, IRProcessing, TranslateByteCode


class _Remembering:
    """A typing context that is asked the same thing once: what `float * float` is, say."""

    def __init__(self, context: Any) -> None:
        self._context = context
        self._answers: dict[Any, Any] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def resolve_function_type(self, called: Any, args: Any, kws: Any) -> Any:
        """The signature of a call; numba's own answer, from memory the second time."""
        question = (called, args, tuple(kws.items()))
        if question not in self._answers:
            self._answers[question] = self._context.resolve_function_type(called, args, kws)
        return self._answers[question]


@register_pass(mutates_CFG=True, analysis_only=False)
class PageTypes(NopythonTypeInference):
    """Numba's type inference, remembering signatures while it infers one function."""

    _name = "page_types"

    def run_pass(self, state: Any) -> bool:
        """Infer."""
        context = state.typingctx
        state.typingctx = _Remembering(context)
        try:
            NopythonTypeInference.run_pass(self, state)
        finally:
            state.typingctx = context
        return True


class _PageLower(Lower):
    """Numba's lowering, with the signature that an operation was inferred to have."""

    def lower_binop(self, resty: Any, expr: Any, op: Any) -> Any:
        """`lhs op rhs`; the page's numbers are no types of their own, as `x ** 2` might want."""
        given: Any = self  # numba says nothing of types
        signature = self.fndesc.calltypes[expr]
        operands = [
            self.context.cast(self.builder, given.loadvar(v.name), given.typeof(v.name), wanted)
            for v, wanted in zip((expr.lhs, expr.rhs), signature.args, strict=True)
        ]
        called = self.context.typing_context.resolve_value_type(op)
        made = self.context.get_function(called, signature)(self.builder, operands)
        return self.context.cast(self.builder, made, signature.return_type, resty)


@register_pass(mutates_CFG=True, analysis_only=False)
class PageLowering(NativeLowering):
    """Numba's way to LLVM, by `_PageLower`."""

    _name = "page_lowering"

    @property
    def lowering_class(self) -> Any:
        """What lowers."""
        return _PageLower


class PageCompiler(CompilerBase):
    """Bytecode, types, LLVM."""

    def define_pipelines(self) -> list[Any]:
        """The one pipeline."""
        passes = PassManager("page")
        passes.add_pass(TranslateByteCode, "bytecode")
        passes.add_pass(FixupArgs, "arguments")
        passes.add_pass(IRProcessing, "intermediate representation")
        passes.add_pass(PageTypes, "types")
        passes.add_pass(PageLowering, "LLVM")
        passes.add_pass(NoPythonBackend, "machine code")
        passes.finalize()
        return [passes]


# njit's stubs do not know every option.
_OPTIONS: Any = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "_nrt": False,
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
