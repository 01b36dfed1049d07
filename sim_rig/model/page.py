"""The compiled page's text: the skeleton with every effect of a catalogue written in.

All effects are always in it, each behind `if strength != 0.0`: another combination is another
array of parameters and no compilation. The text holds the source of every law, so its hash
changes whenever an effect's file does.
"""

import inspect
import re
from collections.abc import Iterable, Iterator, Mapping

from sim_rig.effects.effect import Effect, Port
from sim_rig.model import contact, holding, lesser, play, propagator, saturated, skeleton
from sim_rig.model.inline import Inlined, inline

_MARKER = re.compile(
    r"^(?P<indent> *)# (?P<what>parameters|memory|pack|(port|keep) (?P<port>\w+))$"
)


_SPRINGS = {
    Port.TRANSMISSION: ("compliance", "damping", "load_inertia", "slope"),
    Port.COUPLING: ("shaft_compliance", "shaft_damping", "hub_inertia"),
}
_KEPT = {Port(name) for name in re.findall(r"# keep (\w+)", inspect.getsource(skeleton.run))}
"""Ports that are asked more than once in a step: what is remembered is taken on once."""


def parameter_names(effects: Mapping[str, Effect]) -> list[tuple[str, str]]:
    """(effect, parameter) in the order of the flat array."""
    return [(name, field) for name, effect in effects.items() for field in effect.params._fields]


def memory_names(effects: Mapping[str, Effect]) -> list[tuple[str, str]]:
    """(effect, field) in the order of the state's tail."""
    return [
        (name, field)
        for name, effect in effects.items()
        if effect.memory is not None
        for field in effect.memory._fields
    ]


def page_text(effects: Mapping[str, Effect]) -> str:
    """The page as a Python module that runs as it is, and compiles."""
    functions = [
        inspect.getsource(function)
        for function in (
            lesser.lesser,
            lesser.greater,
            saturated.saturated,
            propagator.propagator,
            contact.sprung,
            contact.swung,
            contact.oscillate,
            contact.twisted,
            contact.upward,
            contact.left_at,
            contact.piece_of,
            contact.meet,
            holding.nearer,
            play.reach,
            play.share_pushed,
        )
    ]
    source = inspect.getsource(skeleton.run)
    source = re.sub(r"NDArray\[np\.float64\]|  # noqa.*$", _plain, source, flags=re.MULTILINE)
    lines = []
    for line in source.splitlines():
        found = _MARKER.match(line)
        if found is None:
            lines.append(line)
        else:
            lines += [found["indent"] + new for new in _written(effects, found)]
    header = [
        '"""The rig with every effect. Written by sim_rig.model.page; edit the effects instead."""',
        "from math import atan, atan2, ceil, copysign, cos, exp, expm1, floor, hypot, log, sin",
        "from math import sqrt, tan",
        "",
        f"CLOSED, MECHANICS, MOTION = {skeleton.CLOSED}, {skeleton.MECHANICS}, {skeleton.MOTION}",
        f"QUEUE, HEAD, MEMORY = {skeleton.QUEUE}, {skeleton.HEAD}, {skeleton.MEMORY}",
        f"ATTEMPTS, HELD = {holding.ATTEMPTS}, {holding.HELD}",
        f"IMPACT_S, FINER = {skeleton.IMPACT_S}, {skeleton.FINER}",
        f"OUT_RAD = {contact.OUT_RAD}",
    ]
    return "\n".join([*header, "\n", "\n\n".join(functions), "", "\n".join(lines), ""])


def _plain(found: re.Match[str]) -> str:
    return "'array'" if found[0].startswith("NDArray") else ""


def _written(effects: Mapping[str, Effect], marker: re.Match[str]) -> Iterator[str]:
    if marker["what"] == "parameters":
        for k, (name, field) in enumerate(parameter_names(effects)):
            yield f"{name}_{field} = parameters[{k}]"
    elif marker["what"] == "memory":
        for k, (name, field) in enumerate(memory_names(effects)):
            yield f"{name}_z_{field} = state[MEMORY + {k}]"
    elif marker["what"] == "pack":
        for k, (name, field) in enumerate(memory_names(effects)):
            yield f"state[MEMORY + {k}] = {name}_z_{field}"
    else:
        port = Port(marker["port"])
        yield f"# {port}"
        for effect in effects.values():
            if effect.port is port and marker["what"].startswith("keep"):
                yield from _kept(effect)
            elif effect.port is port:
                yield from _entered(effect)


def _acts(effect: Effect) -> str:
    return " or ".join(f"{effect.name}_{name} != 0.0" for name in effect.strengths)


def _kept(effect: Effect) -> Iterator[str]:
    """What one effect remembers of its port, where that is asked more than once."""
    if effect.memory is not None:
        yield f"if {_acts(effect)}:"
        yield from (f"    {line}" for line in _taken_on(effect, effect.memory._fields))


def _taken_on(effect: Effect, fields: Iterable[str]) -> list[str]:
    return [f"{effect.name}_z_{field} = {effect.name}_new_{field}" for field in fields]


def _entered(effect: Effect) -> Iterator[str]:
    """One effect at its port. Law and advance both see the value that comes in."""
    yield f"if {_acts(effect)}:  # {effect.summary}"
    body = inline(effect, effect.law)
    lines, last = body.lines, []
    if effect.advance is not None and effect.memory is not None:
        after = inline(effect, effect.advance)
        new = [f"{effect.name}_new_{field}" for field in effect.memory._fields]
        shared = _shared(after.lines, body.lines)
        ends = [f"{n} = {value}" for n, value in zip(new, after.value, strict=True)]
        lines = [*after.lines, *ends, *body.lines[shared:]]
        last = [] if effect.port in _KEPT else _taken_on(effect, effect.memory._fields)
    for line in (*lines, *_handed_on(effect, body), *last):
        yield f"    {line}"


def _shared(first: list[str], second: list[str]) -> int:
    """How many lines both begin with."""
    pairs = enumerate(zip(first, second, strict=False))
    return next((k for k, (a, b) in pairs if a != b), min(len(first), len(second)))


def _handed_on(effect: Effect, body: Inlined) -> list[str]:
    sums = _SPRINGS.get(effect.port)
    if sums is not None:
        return [f"{name} += {value}" for name, value in zip(sums, body.value, strict=True)]
    (value,) = body.value
    return [f"{effect.port.value} {'+=' if effect.port.is_sum else '='} {value}"]
