"""Which effects pay: forward by the gain on blocks that did not choose them, backward, exchanged.

The first effect that is taken stands in for all that come after it: in the end each may give way to
another that does better beside the rest. How well is in `held`.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from servo_bench.diagnosis.elsewhere import gate
from servo_bench.diagnosis.elsewhere.equation import (
    Design,
    base_design,
    covariance,
    design,
    size_of,
    solve,
)
from servo_bench.diagnosis.elsewhere.held import (
    block_costs,
    compared,
    fitted,
    folds_of,
    held_errors,
)
from servo_bench.diagnosis.elsewhere.spectrum import lines, mixed_orders, no_twins, twins
from servo_bench.diagnosis.elsewhere.terms import Electric, Term, candidates, columns, reads_effort
from servo_bench.diagnosis.elsewhere.weak import WeakRows
from servo_bench.diagnosis.fitting.foreign_channels import Array
from sim_rig.effects.effect import Port

FAR_BEYOND = 5.0
"""Of the largest effort: a larger torque was never seen, but extrapolated from a small angle."""
EXCHANGES = 3
"""Rounds in which one effect may give way to another."""
LARGEST_OFF = 2.0
"""How far from one the coefficient of an effect of fixed size may be, either way."""


@dataclass(frozen=True)
class Step:
    """What one term gains on held-out blocks; `rivals` are the best of every other effect."""

    term: Term
    z: float
    share: float
    rivals: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Selected:
    """The equation at the end, and what the best refused effect would have gained."""

    design: Design
    coefficients: Array
    weight: Array
    steps: tuple[Step, ...]
    refused: Step | None


def select(
    rows: WeakRows,
    *,
    voltage: bool,
    inverse: bool = False,
    without: Collection[str] = (),
    only: Collection[str] = (),
) -> Selected:
    """Forward and backward selection on these rows."""
    folds = folds_of(rows)
    now = base_design(rows, voltage=voltage, inverse=inverse)
    plain = tuple(candidates(rows, voltage=voltage, inverse=inverse, without=without, only=only))
    steps: list[Step] = []
    refused: Step | None = None
    made: dict[str, Array] = {}
    while True:
        coefficients, weight, electric = fitted(now)
        now = design(rows, now.terms, electric, voltage=voltage, inverse=inverse)
        if len(now.terms) == gate.MOST_TERMS:
            break
        errors = (now.target - now.matrix @ coefficients) * weight**2
        lined = lines(rows, errors, electric, now.terms, without=without, only=only)
        tried = [*plain, *(t for t in lined if not (inverse and reads_effort(t.effect)))]
        if voltage:
            made.clear()  # the electric torque has changed
        best = _best(now, tried, weight, folds, partial(_made, made, rows, electric))
        if best is None or not passes(best[0]):
            refused = best[0] if best is not None else None
            break
        steps.append(best[0])
        now = best[1]
    now, steps = _backward(now, steps, folds)
    for _ in range(EXCHANGES):
        alike = partial(twins, without=without, only=only) if not inverse else no_twins
        exchanged = _exchanged(now, steps, (plain, alike), folds, partial(_made, made, rows))
        if exchanged is None:
            break
        now, steps = _backward(*exchanged, folds)
    coefficients, weight, _ = fitted(now)
    return Selected(now, coefficients, weight, tuple(steps), refused)


def passes(step: Step) -> bool:
    """Whether a gain is beyond chance and worth a name."""
    return step.z >= gate.HELD_Z and step.share >= gate.HELD_SHARE


def _best(
    now: Design,
    tried: Sequence[Term],
    weight: Array,
    folds: NDArray[np.int64],
    made: Callable[[Term], Array],
) -> tuple[Step, Design] | None:
    """The term that gains most, and the equation with it."""
    before = block_costs(held_errors(now, weight, folds), now.rows)
    found: list[tuple[Array, Design]] = []
    for one in tried:
        if any(t.name == one.name and t.order == one.order for t in now.terms):
            continue
        term, added = _novel(now, one, made(one), weight)
        if not added.size or _is_small(now, added, weight):
            continue
        more = now.plus(term, added)
        coefficients = solve(more.matrix, more.target, weight)
        if not _has_meaning(more, len(more.terms) - 1, coefficients):
            continue
        found.append((block_costs(held_errors(more, weight, folds), now.rows), more))
    if not found:
        return None
    found.sort(key=lambda one: float(one[0].sum()))
    gain = float((before - found[0][0]).sum())
    equals = [
        one
        for one in found
        if float((before - one[0]).sum()) >= gate.EQUAL_GAIN * gain
        and compared(found[0][0], one[0])[0] < gate.SECURE_Z
    ]
    costs, best = min(equals or found[:1], key=lambda one: _assumed(one[1]))
    rivals: dict[str, float] = {}
    for other, rival in found:
        name = rival.terms[-1].name
        if name != best.terms[-1].name and name not in rivals:
            rivals[name] = compared(costs, other)[0]
    return Step(best.terms[-1], *compared(costs, before), tuple(rivals.items())), best


def _assumed(more: Design) -> tuple[bool, tuple[int, int, int]]:
    """What tells the simpler of two equals: a further line of what is there is no new effect."""
    last, there = more.terms[-1], more.terms[:-1]
    return all(t.name != last.name for t in there), last.complexity


def _made(there: dict[str, Array], rows: WeakRows, electric: Electric, term: Term) -> Array:
    """The columns of a term, computed once."""
    key = f"{term.name} {sorted(term.shape.items())} {term.strength} {term.size}"
    if key not in there:
        there[key] = columns(term, rows, electric)
    return there[key]


def _novel(now: Design, term: Term, added: Array, weight: Array) -> tuple[Term, Array]:
    """The term and those of its columns that what is there does not make already.

    A phase that cannot be had is fixed: of a pendulum that hardly swings, the cosine is constant.
    """
    heavy, there = added * weight[:, None], now.matrix * weight[:, None]
    there = there / (np.linalg.norm(there, axis=0) + 1e-300)
    left = heavy - there @ np.linalg.lstsq(there.T @ there, there.T @ heavy, rcond=1e-10)[0]
    size = np.linalg.norm(heavy, axis=0)
    novel = np.linalg.norm(left, axis=0) > np.sqrt(gate.ALIKE) * size
    if term.phase is None or novel.all() or not novel.any():
        return term, added if novel.any() else added[:, :0]
    kept = int(np.flatnonzero(novel)[0])
    return term.at_phase(0.5 * np.pi * kept), added[:, [kept]]


def _is_small(now: Design, added: Array, weight: Array) -> bool:
    """Whether its torque, at the size that fits, is too small beside the effort for a name."""
    matrix = np.concatenate([now.matrix, added], axis=1)
    coefficients = solve(matrix, now.target, weight)
    made = added @ coefficients[now.matrix.shape[1] :]
    effort = now.target if now.inverse else now.matrix[:, 0] * coefficients[0]
    return float(np.std(made)) < gate.MATERIAL * float(np.std(effort))


def _is_sure(size: float, error: float) -> bool:
    return abs(size) > gate.SURE * error


def _has_meaning(now: Design, number: int, coefficients: Array) -> bool:
    """Whether a term's size has the sign that it must have, the one that was assumed, and is no
    torque far beyond the effort; and whether a line is more than what others make of the
    current."""
    term = now.terms[number]
    sizes = now.in_effort(coefficients)[now.owned(number)]
    if term.strength.endswith("torque_nm") and term.size is None:
        largest = max(float(np.abs(s.effort).max()) for s in now.rows.stretches)
        if float(np.hypot.reduce(sizes)) > FAR_BEYOND * largest:
            return False
    if term.phase is not None:
        ripples = term.effect.port is Port.ELECTRIC_TORQUE
        return not (ripples and term.order in mixed_orders(now.terms))
    size = float(sizes[0])
    if term.size is not None:
        return 1.0 / LARGEST_OFF < size < LARGEST_OFF
    return (size > 0.0 or term.signed) and abs(size) <= term.most


def _backward(
    now: Design, steps: Sequence[Step], folds: NDArray[np.int64]
) -> tuple[Design, list[Step]]:
    """Take out what does not pay beside all others, whose size may as well be zero, or has no
    meaning; every step's figures are as of the end."""
    while now.terms:
        coefficients, weight, _ = fitted(now)
        spread = covariance(now, coefficients, weight)
        whole = block_costs(held_errors(now, weight, folds), now.rows)
        figures = [
            compared(whole, block_costs(held_errors(now.without(k), weight, folds), now.rows))
            for k in range(len(now.terms))
        ]
        finals = list(_finals(now, steps, figures))
        failed = [
            k
            for k, step in enumerate(finals)
            if not passes(step)
            or not _is_sure(*size_of(now, k, coefficients, spread))
            or not _has_meaning(now, k, coefficients)
        ]
        if not failed:
            return now, finals
        now = now.without(min(failed, key=lambda k: finals[k].share))
    return now, []


def _exchanged(
    now: Design,
    steps: Sequence[Step],
    asked: tuple[Sequence[Term], Callable[[Term], Sequence[Term]]],
    folds: NDArray[np.int64],
    made: Callable[[Electric, Term], Array],
) -> tuple[Design, list[Step]] | None:
    """The equation with another effect in place of one or two, where that pays; else None.

    `asked` are the effects without a line, and what tells a line's rivals at its order.
    """
    _, weight, electric = fitted(now)
    cost = float(block_costs(held_errors(now, weight, folds), now.rows).sum())
    best: tuple[Design, list[Step]] | None = None
    least = (1.0 - gate.HELD_SHARE) * cost
    for out in _sets(now):
        less, gone = now, [now.terms[k] for k in out]
        for k in sorted(out, reverse=True):
            less = less.without(k)
        plain, lined = asked
        others = [*lined(gone[0]), *(t for t in plain if t not in gone)]
        found = _best(less, others, weight, folds, partial(made, electric))
        if found is None:
            continue
        step, more = found
        cost = float(block_costs(held_errors(more, weight, folds), now.rows).sum())
        if cost < least:
            kept = [s for s in steps if all(s.term is not g for g in gone)]
            least, best = cost, (more, [*kept, step])
    return best


def _sets(now: Design) -> Iterator[tuple[int, ...]]:
    """What may give way together, by number: one effect, or two that are no lines."""
    yield from combinations(range(len(now.terms)), 1)
    yield from combinations([k for k, term in enumerate(now.terms) if term.order is None], 2)


def _finals(
    now: Design, steps: Sequence[Step], figures: Sequence[tuple[float, float]]
) -> Iterator[Step]:
    for term, (z, share) in zip(now.terms, figures, strict=True):
        first = next(s for s in steps if s.term is term)
        yield Step(term, z, share, first.rivals)
