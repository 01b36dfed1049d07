"""Numba with the passes that the page needs, and no others: a third of its time to compile.

The page is floats, loops, and calls: nothing to inline, to unroll, or to rewrite, and every name
has one type, so that LLVM may bring it into single assignment by itself. Its arrays are the
caller's, and nothing counts references to them. What `float * float` is, is asked once and not a
thousand times. A custom pipeline is numba's own way to say so (its manual, "Customizing the
Compiler").
"""

from collections.abc import Callable
from itertools import count
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.dispatcher import Dispatcher
from numba.core.lowering import Lower
from numba.core.postproc import VariableLifetime
from numba.core.transforms import canonicalize_cfg
from numba.core.typed_passes import NativeLowering, NoPythonBackend, NopythonTypeInference
from numba.core.untyped_passes import FixupArgs, IRProcessing, TranslateByteCode
from numba.np.arrayobj import populate_array

from sim_rig.model.machine_code import MachineCode


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
class PageFlow(IRProcessing):
    """Numba's control flow; which variables live where, only those ask who delete or yield."""

    _name = "page_flow"

    def run_pass(self, state: Any) -> bool:
        """Make it canonical."""
        code = state.func_ir
        code.blocks = canonicalize_cfg(code.blocks)
        code.variable_lifetime = VariableLifetime(code.blocks)  # computes nothing until asked
        code.generator_info = None
        return True


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

    def create_cfunc_wrapper(self) -> None:
        """Instead of numba's wrapper, which takes no arrays: `machine_code`'s entry."""
        given: Any = self
        context, described = given.context, given.fndesc
        module = context.create_module("entry")
        convention = context.call_conv
        called = ir.Function(
            module,
            convention.get_function_type(described.restype, described.argtypes),
            described.llvm_func_name,
        )
        word = ir.IntType(64)
        entry = ir.Function(
            module,
            ir.FunctionType(ir.IntType(32), [word.as_pointer()]),
            described.llvm_cfunc_wrapper_name,
        )
        builder = ir.IRBuilder(entry.append_basic_block())
        place = count()

        def next_word() -> ir.Value:
            return builder.load(builder.gep(entry.args[0], [word(next(place))]))

        arguments = [_argument(context, builder, kind, next_word) for kind in described.argtypes]
        status, complete = convention.call_function(
            builder, called, described.restype, described.argtypes, arguments
        )
        answer = builder.zext(complete, ir.IntType(32))
        builder.ret(builder.select(status.is_error, ir.IntType(32)(-1), answer))
        given.library.add_ir_module(module)


def _argument(context: Any, builder: Any, kind: Any, next_word: Callable[[], Any]) -> Any:
    """What the words say, as numba's code takes it."""
    if isinstance(kind, types.Integer):
        return next_word()
    if isinstance(kind, types.Float):
        return builder.bitcast(next_word(), ir.DoubleType())
    array = context.make_array(kind)(context, builder)
    data = builder.inttoptr(next_word(), array.data.type)
    shape = [next_word() for _ in range(kind.ndim)]
    strides = [ir.IntType(64)(8)]
    for length in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    populate_array(array, data, shape, strides, ir.IntType(64)(8), meminfo=None)
    return array._getvalue()


class _PageLibrary(JITCodeLibrary):
    """The page's long function: optimised once, with its helpers, and not before by itself."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = str(self.codegen.target_data)


@register_pass(mutates_CFG=True, analysis_only=False)
class PageLowering(NativeLowering):
    """Numba's way to LLVM, by `_PageLower`; what has an entry, into a `_PageLibrary`."""

    _name = "page_lowering"

    def run_pass(self, state: Any) -> bool:
        """Lower."""
        if not state.flags.no_cfunc_wrapper:
            library: Any = _PageLibrary
            state.library = library(state.targetctx.codegen(), state.func_id.func_qualname)
            state.library.enable_object_caching()
        NativeLowering.run_pass(self, state)
        return True

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
        passes.add_pass(PageFlow, "control flow")
        passes.add_pass(PageTypes, "types")
        passes.add_pass(PageLowering, "LLVM")
        passes.add_pass(NoPythonBackend, "machine code")
        passes.finalize()
        return [passes]


# njit's stubs do not know every option.
_HELPER: Any = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "no_cpython_wrapper": True,
    "_nrt": False,
    "pipeline_class": PageCompiler,
}
_RUN: Any = {**_HELPER, "no_cpython_wrapper": False}
_ENTERED: Any = {**_HELPER, "no_cfunc_wrapper": False}


def compiled_helper(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that only compiled ones call."""
    helper: Callable[..., Any] = njit(**_HELPER)(function)
    return helper


def compiled_run(function: Callable[..., Any], signature: str) -> Callable[..., Any]:
    """A function that Python calls through numba."""
    run: Callable[..., Any] = njit(signature, **_RUN)(function)
    return run


def machine_code(function: Callable[..., Any], signature: str) -> MachineCode | None:
    """A function as an object file with an entry for `LinkedRun`; None where jit is disabled."""
    compiled: Any = njit(signature, **_ENTERED)(function)
    if not isinstance(compiled, Dispatcher):
        return None
    made: Any = next(iter(compiled.overloads.values()))
    code = made.library._get_compiled_object()  # what numba's own cache keeps
    return MachineCode(made.fndesc.llvm_cfunc_wrapper_name, bytes(code))
