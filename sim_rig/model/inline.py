"""A law's source as lines of the page: names instead of fields, `math` instead of numpy.

`s.x` becomes `x`, `p.x` `EFFECT_x`, `z.x` `EFFECT_z_x`; a number that the file defines becomes
that number; np.where becomes a lazy `a if c else b`.
"""

import ast
import inspect
import textwrap
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from sim_rig.effects.effect import Effect, Signals
from sim_rig.errors import EffectError

_RENAMED = {
    **{name: name for name in ("sin", "cos", "tan", "exp", "expm1", "log", "sqrt")},
    **{"floor": "floor", "hypot": "hypot", "abs": "abs", "minimum": "lesser", "maximum": "greater"},
    **{"arctan": "atan", "arctan2": "atan2", "tanh": "saturated"},
}


class Inlined(NamedTuple):
    """Statements to run first, and the returned expression, each as source."""

    lines: list[str]
    value: list[str]


def inline(effect: Effect, function: Callable[..., Any]) -> Inlined:
    """The body of `law` or `advance`. EffectError where it is not a row of assignments."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    definition = tree.body[0]
    assert isinstance(definition, ast.FunctionDef)  # noqa: S101 - getsource of a def
    arguments = [argument.arg for argument in definition.args.args]
    body = definition.body[1:] if ast.get_docstring(definition) else definition.body
    *assignments, last = body
    if not (isinstance(last, ast.Return) and last.value is not None):
        raise EffectError(f"{effect.name}.{function.__name__}: end it with one return.")
    translate = _Translate(effect, function, arguments)
    lines = []
    for statement in assignments:
        if not isinstance(statement, ast.Assign):
            raise EffectError(
                f"{effect.name}.{function.__name__}: {ast.unparse(statement)!r}: "
                "only assignments and one return can be written into the page."
            )
        lines.append(ast.unparse(translate.visit(statement)))
    value = last.value
    if isinstance(value, ast.Call) and _is_memory(effect, value.func):
        values: list[ast.expr] = _in_order(effect, value)
    elif isinstance(value, ast.Tuple):
        values = value.elts
    else:
        values = [value]
    return Inlined(lines, [ast.unparse(translate.visit(value)) for value in values])


def _is_memory(effect: Effect, called: ast.expr) -> bool:
    memory = effect.memory
    return memory is not None and isinstance(called, ast.Name) and called.id == memory.__name__


def _in_order(effect: Effect, call: ast.Call) -> list[ast.expr]:
    fields: tuple[str, ...] = effect.memory._fields if effect.memory else ()
    values = dict(zip(fields, call.args, strict=False))
    values |= {keyword.arg: keyword.value for keyword in call.keywords if keyword.arg}
    if tuple(field for field in fields if field in values) != fields:
        raise EffectError(f"{effect.name}.advance: give every field of Memory: {fields}.")
    return [values[field] for field in fields]


class _Translate(ast.NodeTransformer):
    def __init__(self, effect: Effect, function: Callable[..., Any], arguments: list[str]) -> None:
        self._effect, self._globals = effect, function.__globals__
        self._where = f"{effect.name}.{function.__name__}"
        self._prefix = f"{effect.name}_"
        self._step = arguments[3] if len(arguments) > 3 else None
        self._fields: Mapping[str, tuple[tuple[str, ...], str]] = {
            "s": (Signals._fields, ""),
            "p": (effect.params._fields, f"{effect.name}_"),
            "z": (effect.memory._fields if effect.memory else (), f"{effect.name}_z_"),
        }

    def _refuse(self, node: ast.AST) -> EffectError:
        return EffectError(
            f"{self._where}: {ast.unparse(node)!r} cannot be written into the page; "
            "sim_rig.effects says what a law may use."
        )

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        if not isinstance(node.value, ast.Name):
            raise self._refuse(node)
        owner = node.value.id
        if owner == "np" and node.attr == "pi":
            return ast.Constant(3.141592653589793)
        fields, prefix = self._fields.get(owner, ((), ""))
        if node.attr not in fields:
            raise self._refuse(node)
        return ast.Name(prefix + node.attr, node.ctx)

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if node.id == self._step:
            return ast.Name("step_s", node.ctx)
        if node.id in self._globals:
            value = self._globals[node.id]
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise self._refuse(node)
            return ast.Constant(float(value))
        return ast.Name(self._prefix + node.id, node.ctx)

    def visit_Call(self, node: ast.Call) -> ast.AST:
        called = node.func
        if not (
            isinstance(called, ast.Attribute)
            and isinstance(called.value, ast.Name)
            and called.value.id == "np"
            and not node.keywords
        ):
            raise self._refuse(node)
        arguments = [self.visit(argument) for argument in node.args]
        name = called.attr
        if name == "where":
            test, yes, no = arguments
            return ast.IfExp(test, yes, no)
        if name == "sign":
            (x,) = arguments
            zero = ast.Compare(x, [ast.NotEq()], [ast.Constant(0.0)])
            return ast.IfExp(zero, _call("copysign", ast.Constant(1.0), x), ast.Constant(0.0))
        if name == "clip":
            x, low, high = arguments
            return _call("lesser", _call("greater", x, low), high)
        if name == "rint":
            (x,) = arguments
            return _call("floor", ast.BinOp(x, ast.Add(), ast.Constant(0.5)))
        if name in _RENAMED:
            return _call(_RENAMED[name], *arguments)
        raise self._refuse(node)


def _call(name: str, *arguments: ast.expr) -> ast.Call:
    return ast.Call(ast.Name(name, ast.Load()), list(arguments), [])
