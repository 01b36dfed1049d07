"""Gauss-Newton with secants as wide as what is not known, within bounds, on robust costs.

    minimise  sum rho(z(x)) + sum ((x - c)/d)^2

Impacts ripple z at small scale; differences begin one step wide and shrink. Candidates of one
search differ from their base by a few numbers, so a handful of batches of simulations is enough.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Errors, Evidence
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.searching.stepping import (
    Place,
    Point,
    gauss_newton_step,
    surprise,
    within,
)
from servo_bench.diagnosis.searching.unknowns import Unknown, put_all
from sim_rig.model import Model

SHRINK = (1.0, 0.5, 0.25, 0.15, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1)
SETTLED = 1e-3
"""An iteration that lowers the cost by a smaller share is the last but one."""
ROAMING, NARROWER = 12, 0.35
"""Points of a batch that is scattered about a search's end, and how much narrower the next is."""
OWN_SHARE, OWN_ANGLE_RAD = 0.4, 0.5
"""Deviation of the first batch: of a number's own size, and of a phase."""
WORTHWHILE = 0.003
"""A search that scattering helps less is at its end."""


class Found(NamedTuple):
    """Where a search ended. `white` and `jacobian` are whitened by `sigma`."""

    model: Model
    unknowns: tuple[Unknown, ...]
    values: Array
    errors: Errors
    sigma: Array
    jacobian: Array
    cost: float
    settled: bool

    @property
    def belief(self) -> float:
        """How much of the cost is surprise."""
        return surprise(self.unknowns, self.values)

    def value(self, name: str) -> float:
        """The number of that name."""
        return float(self.values[[u.name for u in self.unknowns].index(name)])


def seek(
    evidence: Evidence,
    model: Model,
    unknowns: Sequence[Unknown],
    sigma: Array | None = None,
    *,
    iterations: int = 4,
    coarse: bool = True,
    first: int = 0,
) -> Found:
    """From the model's own values; sigma from the start's errors where none is given.

    `first` skips the widest differences, for a search that goes on where another ended.
    """
    place = Place(evidence, model, tuple(unknowns), coarse)
    free = place.unknowns
    values = np.array([np.clip(u.of(model), u.low, u.high) for u in free])
    errors = place.errors([values])[0]
    weigh = evidence.deviation(errors) if sigma is None else sigma
    at = Point(values, errors, errors.cost(weigh) + surprise(free, values))
    jacobian = np.zeros((errors.rows.size, len(free)))
    quiet = 0
    for width in SHRINK[first : first + iterations]:
        jacobian = place.jacobian(at.values, at.errors, weigh, width)
        step = gauss_newton_step(jacobian, at.errors.white(weigh), free, at.values)
        end = place.along(at.values, step, weigh)
        gained = at.cost - end.cost
        at = end if gained > 0.0 else at
        quiet = quiet + 1 if gained < SETTLED * at.cost else 0
        if quiet == 2:
            break
    values, errors, cost = at
    found = put_all(model, free, list(values))
    settled = quiet > 0 or not free
    values, jacobian = _apart(free, found, values), _own_columns(free, found, jacobian)
    return Found(found, free, values, errors, weigh, jacobian, cost, settled)


def _apart(unknowns: Sequence[Unknown], model: Model, values: Array) -> Array:
    """The numbers as they are in the model: one that another carries was put before that."""
    carried = {name for u in unknowns for name in u.carried}
    pairs = zip(unknowns, values, strict=True)
    return np.array([u.of(model) if u.name in carried else float(v) for u, v in pairs])


def _own_columns(unknowns: Sequence[Unknown], model: Model, jacobian: Array) -> Array:
    """Secants of every number alone: what it carried along is put back."""
    columns = {u.name: k for k, u in enumerate(unknowns)}
    own = jacobian.copy()
    for k, unknown in enumerate(unknowns):
        for name in columns.keys() & set(unknown.carried):
            own[:, k] += unknown.share_of(name, model) * jacobian[:, columns[name]]
    return own


def settle(
    evidence: Evidence,
    found: Found,
    own: Collection[str],
    *,
    turns: int = 2,
    coarse: bool = True,
) -> Found:
    """Go on from where a search ended until neither secants nor scattering help.

    Impacts make valleys of their own: a search by secants may end in one whose floor lies far above
    that of the next. Points scattered about the numbers of the effects in `own` find the way out.
    """
    for turn in range(turns):
        moved = roam(evidence, found, own, coarse=coarse, seed=turn)
        again = seek(
            evidence, moved.model, found.unknowns, found.sigma, iterations=2, first=2, coarse=coarse
        )
        if again.cost > found.cost:
            break
        gained, found = found.cost - again.cost, again
        if gained < WORTHWHILE * found.cost:
            break
    return found


def roam(
    evidence: Evidence,
    found: Found,
    own: Collection[str],
    *,
    coarse: bool = True,
    seed: int = 0,
    batches: int = 4,
) -> Found:
    """The best of some points scattered about a search's end; its secants stay as they were."""
    place = Place(evidence, found.model, found.unknowns, coarse=True)
    free = place.unknowns
    mine = np.array([u.effect in own for u in free], dtype=bool)
    if not mine.any():
        return found
    rng = np.random.default_rng((seed, len(free)))
    at = Point(found.values, found.errors, found.cost)
    if not coarse:
        at = place.lowest([at.values], found.sigma)
    spread = 1.0
    for _ in range(batches):
        deviation = np.where(mine, spread * _own_deviation(free, at.values), 0.0)
        scattered = at.values + deviation * rng.standard_normal((ROAMING, at.values.size))
        end = place.lowest([within(free, values) for values in scattered], found.sigma)
        if end.cost < at.cost:
            at = end
        else:
            spread *= NARROWER
    if not coarse:
        at = place._replace(coarse=False).lowest([at.values], found.sigma)
        if at.cost >= found.cost:
            return found
    values, errors, cost = at
    model = put_all(found.model, free, list(values))
    return found._replace(model=model, values=_apart(free, model, values), errors=errors, cost=cost)


def _own_deviation(unknowns: Sequence[Unknown], values: Array) -> Array:
    sizes = np.maximum(OWN_SHARE * np.abs(values), [0.05 * u.step for u in unknowns])
    return np.where([u.circular for u in unknowns], OWN_ANGLE_RAD, sizes)
