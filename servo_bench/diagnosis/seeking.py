"""Gauss-Newton with secants as wide as what is not known, within bounds, on robust costs.

    minimise  sum rho(z(x)) + sum ((x - c)/d)^2

Impacts ripple z at small scale; differences begin one step wide and shrink. Candidates of one
search differ from their base by a few numbers, so a handful of batches of simulations is enough.
Secants, and points that are scattered, are played in coarse steps always: a difference of two says
the same, and what is taken is weighed in the steps that were asked for.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.evidence import KNEE, Errors, Evidence
from servo_bench.diagnosis.rows import Array
from servo_bench.diagnosis.unknowns import Unknown, put_all
from sim_rig.errors import SimRigError
from sim_rig.model import Model

SHRINK = (1.0, 0.5, 0.25, 0.15, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1)
TRIED = (1.0, 0.4, 0.1)
"""Shares of a Gauss-Newton step that are tried at once."""
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


def surprise(unknowns: Sequence[Unknown], values: Array) -> float:
    """Sum of squared deviations from what was believed."""
    return float(
        sum(((v - u.centre) / u.deviation) ** 2 for u, v in zip(unknowns, values, strict=True))
    )


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
    place = _Place(evidence, model, tuple(unknowns), coarse)
    free = place.unknowns
    values = np.array([np.clip(u.of(model), u.low, u.high) for u in free])
    errors = place.errors([values])[0]
    weigh = evidence.deviation(errors) if sigma is None else sigma
    cost = errors.cost(weigh) + surprise(free, values)
    jacobian = np.zeros((errors.rows.size, len(free)))
    quiet = 0
    for width in SHRINK[first : first + iterations]:
        jacobian = place.jacobian(values, errors, weigh, width)
        step = _step(jacobian, errors.white(weigh), free, values)
        ends = [_turned(free, np.clip(values + s * step, _low(free), _high(free))) for s in TRIED]
        tried = place.errors(ends)
        costs = [e.cost(weigh) + surprise(free, x) for e, x in zip(tried, ends, strict=True)]
        best = int(np.argmin(costs))
        gained = cost - costs[best]
        if gained > 0.0:
            values, errors, cost = ends[best], tried[best], costs[best]
        quiet = quiet + 1 if gained < SETTLED * cost else 0
        if quiet == 2:
            break
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
    place = _Place(evidence, found.model, found.unknowns, coarse=True)
    free = place.unknowns
    mine = np.array([u.effect in own for u in free], dtype=bool)
    if not mine.any():
        return found
    rng = np.random.default_rng((seed, len(free)))
    values, errors, cost = found.values, found.errors, found.cost
    if not coarse:
        errors = place.errors([values])[0]
        cost = errors.cost(found.sigma) + surprise(free, values)
    spread = 1.0
    for _ in range(batches):
        deviation = np.where(mine, spread * _own_deviation(free, values), 0.0)
        scattered = values + deviation * rng.standard_normal((ROAMING, values.size))
        ends = [_turned(free, np.clip(end, _low(free), _high(free))) for end in scattered]
        tried = place.errors(ends)
        costs = [e.cost(found.sigma) + surprise(free, x) for e, x in zip(tried, ends, strict=True)]
        best = int(np.argmin(costs))
        if costs[best] < cost:
            values, errors, cost = ends[best], tried[best], costs[best]
        else:
            spread *= NARROWER
    if not coarse:
        errors = place._replace(coarse=False).errors([values])[0]
        cost = errors.cost(found.sigma) + surprise(free, values)
        if cost >= found.cost:
            return found
    model = put_all(found.model, free, list(values))
    return found._replace(model=model, values=_apart(free, model, values), errors=errors, cost=cost)


def _own_deviation(unknowns: Sequence[Unknown], values: Array) -> Array:
    sizes = np.maximum(OWN_SHARE * np.abs(values), [0.05 * u.step for u in unknowns])
    return np.where([u.circular for u in unknowns], OWN_ANGLE_RAD, sizes)


def _low(unknowns: Sequence[Unknown]) -> Array:
    return np.array([u.low for u in unknowns])


def _high(unknowns: Sequence[Unknown]) -> Array:
    return np.array([u.high for u in unknowns])


def _turned(unknowns: Sequence[Unknown], values: Array) -> Array:
    circular = np.array([u.circular for u in unknowns])
    return np.where(circular, (values + np.pi) % (2.0 * np.pi) - np.pi, values)


class _Place(NamedTuple):
    """Where numbers are put, and what they are compared with."""

    evidence: Evidence
    model: Model
    unknowns: tuple[Unknown, ...]
    coarse: bool

    def errors(self, rows: Sequence[Array]) -> list[Errors]:
        """For many sets of values, one batch; a set that makes no model counts as run away."""
        models, lost = [], []
        for values in rows:
            try:
                models.append(put_all(self.model, self.unknowns, list(values)))
                lost.append(False)
            except SimRigError:
                models.append(self.model)
                lost.append(True)
        found = self.evidence.seen(models, coarse=self.coarse)
        for errors, gone in zip(found, lost, strict=True):
            if gone:
                errors.rows = np.full_like(errors.rows, np.inf)
        return found

    def jacobian(self, values: Array, errors: Errors, sigma: Array, width: float) -> Array:
        """Secants of the whitened points from `errors`, those of `values`; (points, numbers)."""
        ends = []
        for k, unknown in enumerate(self.unknowns):
            end = values.copy()
            step = width * unknown.step
            end[k] = values[k] + step
            if end[k] > unknown.high:
                end[k] = max(values[k] - step, unknown.low)
            ends.append(end)
        if self.coarse:
            played = self.errors(ends)
        else:
            errors, *played = self._replace(coarse=True).errors([values, *ends])
        here = errors.white(sigma)
        columns = []
        for k, (end, there) in enumerate(zip(ends, played, strict=True)):
            moved = end[k] - values[k]
            usable = moved != 0.0 and not there.ran_away
            columns.append((there.white(sigma) - here) / moved if usable else np.zeros_like(here))
        return np.stack(columns, axis=1) if columns else np.zeros((here.size, 0))


def _step(jacobian: Array, white: Array, unknowns: Sequence[Unknown], values: Array) -> Array:
    """The robust Gauss-Newton step that stays within the bounds."""
    weight = 1.0 / np.sqrt(1.0 + (white / KNEE) ** 2)
    precision = np.array([u.deviation**-2.0 for u in unknowns])
    centre = np.array([u.centre for u in unknowns])
    gram = jacobian.T @ (jacobian * weight[:, None]) + np.diag(precision)
    pull = -jacobian.T @ (white * weight) - precision * (values - centre)
    low, high = _low(unknowns) - values, _high(unknowns) - values
    step = np.zeros(values.size)
    free = np.ones(values.size, np.bool_)
    for _ in range(values.size + 1):
        rest = pull[free] - gram[np.ix_(free, ~free)] @ step[~free]
        step[free] = _solved(gram[np.ix_(free, free)], rest)
        beyond = free & ((step < low) | (step > high))
        if not beyond.any():
            break
        step[beyond] = np.clip(step[beyond], low[beyond], high[beyond])
        free &= ~beyond
    return np.clip(step, low, high)


def _solved(gram: Array, pull: Array) -> Array:
    """With unit diagonal and a trace of ridge: columns may be parallel or empty."""
    if not pull.size:
        return pull
    size = np.sqrt(np.diag(gram))
    size = np.where(size > 0.0, size, 1.0)
    scaled = gram / np.outer(size, size) + 1e-6 * np.eye(pull.size)
    return np.asarray(np.linalg.solve(scaled, pull / size) / size)
