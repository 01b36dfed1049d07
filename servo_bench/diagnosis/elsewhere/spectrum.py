"""Lines in the position spectrum of the equation's errors: whole orders, strongest first.

Every effect with an order (cogging, torque ripple) is asked by its own law. A correlation of weak
rows with a column is one of the rows' adjoint with the torque itself, so that no column is built
for the orders that come to nothing.
"""

from collections.abc import Collection, Iterator, Sequence

import numpy as np

from servo_bench.diagnosis.elsewhere.terms import (
    PORTS,
    SLOWEST_LINE,
    Electric,
    Term,
    order_of,
    torque,
)
from servo_bench.diagnosis.elsewhere.weak import WeakRows, adjoint
from servo_bench.diagnosis.fitting.foreign_channels import FINE, Array, Stretch
from sim_rig.effects import catalogue
from sim_rig.effects.effect import Effect, Port

HIGHEST = 160
MIDDLING = 24
MOST_POINTS = 6000
FEWEST_TURNS = 1.0
STRONGEST = 10
"""Lines of each effect that are tried by held-out gain."""
MOST_LINES = 10
"""Of an effect that has several, though its parameters name three: else a fourth line of cogging
would be called another effect."""


def lines(
    rows: WeakRows,
    errors: Array,
    electric: Electric,
    there: Sequence[Term],
    *,
    without: Collection[str] = (),
    only: Collection[str] = (),
) -> Iterator[Term]:
    """Terms of the strongest lines; none where no full turn was made. `errors` are weighted."""
    turns = max(float(np.ptp(s.angle_rad)) for s in rows.stretches) / (2.0 * np.pi)
    if not np.isfinite(turns) or turns < FEWEST_TURNS:
        return
    slow = [_slow(s, w) for s, w in zip(rows.stretches, adjoint(rows, errors), strict=True)]
    for effect in catalogue().values():
        if effect.port not in PORTS or effect.name in without:
            continue
        if only and effect.name not in only:
            continue
        yield from _of_effect(effect, slow, electric, there)


def _of_effect(
    effect: Effect,
    slow: Sequence[tuple[Stretch, Array]],
    electric: Electric,
    there: Sequence[Term],
) -> Iterator[Term]:
    taken = [t for t in there if t.name == effect.name]
    strengths = [s for s in effect.strengths if order_of(effect, s) is not None]
    if not strengths or len(taken) >= (MOST_LINES if len(strengths) > 1 else 1):
        return
    strength = strengths[min(len(taken), len(strengths) - 1)]
    terms = [t for n in range(2, HIGHEST + 1) if (t := _line(effect, strength, float(n)))]
    if not terms:
        return
    mixed = mixed_orders(there) if effect.port is Port.ELECTRIC_TORQUE else frozenset[float]()
    terms = [term for term in terms if term.order not in mixed]
    heights = [_height(term, slow, electric) for term in terms]
    for k in np.argsort(heights)[::-1][:STRONGEST]:
        yield terms[k]


def _line(effect: Effect, strength: str, at: float) -> Term | None:
    """An effect's line at an order; None of one that has none, or no phase."""
    order = order_of(effect, strength)
    phase = strength.removesuffix("torque_nm").removesuffix("ripple_fraction") + "phase_rad"
    if order is None or phase not in effect.params._fields:
        return None
    counts = {p.name: 1.0 for p in effect.parameters if p.name.endswith("count")}
    return Term(effect, strength, phase, {**counts, order: at})


def twins(term: Term, without: Collection[str], only: Collection[str]) -> list[Term]:
    """Lines of other effects at a line's order."""
    if term.order is None:
        return []
    others = [e for e in catalogue().values() if e.port in PORTS and e.name != term.name]
    asked = [e for e in others if e.name not in without and (not only or e.name in only)]
    return [t for e in asked if (t := _line(e, e.strengths[0], term.order))]


def no_twins(_: Term) -> list[Term]:
    """Where the effort is explained: a ripple of it would explain it by itself."""
    return []


def mixed_orders(there: Sequence[Term]) -> frozenset[float]:
    """Orders at which a ripple of the torque stands in for lines that need no current.

    A current that fights lines of orders n and m has them itself; times one of n - m, n + m, or n
    it makes those lines again, a little larger or later.
    """
    orders = [t.order for t in there if t.order is not None and t.effect.port is Port.MOTOR_TORQUE]
    pairs = [(n, m) for n in orders for m in orders]
    return frozenset({*orders, *(n + m for n, m in pairs), *(abs(n - m) for n, m in pairs)})


def _height(term: Term, slow: Sequence[tuple[Stretch, Array]], electric: Electric) -> float:
    total, size = np.zeros(2), 1e-300
    for stretch, weight in slow:
        driven = electric(stretch)
        for k, phase in enumerate((0.0, 0.5 * np.pi)):
            made = torque(term, stretch, driven, 1.0, phase)
            total[k] += float(made @ weight)
            size += float(made @ made)
    return float(total @ total) / size


def _slow(stretch: Stretch, weight: Array) -> tuple[Stretch, Array]:
    """At most MOST_POINTS of the points that are slow enough for a line of middling order."""
    passing = MIDDLING * np.abs(stretch.velocity_rad_s) * stretch.period_s
    rows = np.flatnonzero(passing < SLOWEST_LINE)[::FINE]
    rows = rows[:: max(1, rows.size // MOST_POINTS)]
    return Stretch(stretch.record, stretch.period_s, *(v[rows] for v in stretch[2:])), weight[rows]
