"""Whether a number is the same at a recording's beginning and at its end.

What warms, wears, or works loose is fitted by its mean, and the cause's name is then a wrong one:
a gap that grows is no gap that was drawn wrong. So that number may have a slope over what was
fitted, t = -1 .. 1, with all others solved along, by one step of robust least squares

    minimise over d, b   sum w (z + S d + s t b)^2 + sum (d/deviation)^2,   w = 1/sqrt(1 + (z/k)^2)

z the whitened error, S its secants, s the number's own; S' w z counts as nothing, because the fit
has ended. What the slope takes of the cost F, and by how much that stands out of the blocks'
scatter, is judged as that of a cause is.
"""

from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.evidence import KNEE, block_z, robust_cost
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.searching.seeking import Found

TAKEN, CHANGED, BEYOND_Z = 0.03, 0.25, 4.0
"""Of the cost, of the number itself, and in the blocks' scatter: a slope with more is there. Of 40
causes that were named rightly on development seeds one changed by more than a twentieth, and took
nothing; five gaps that warm and were called wrong ones changed by 0.6 to 1.4 and took 5 to 32 %."""
CHANGES = frozenset({"thermal_friction", "thermal_torque_constant", "clock_skew"})
"""Causes that are a change themselves: how fast they warm is known to a factor only, and a clock
that walks past a drive's ticks does so in steps (`ticks`), of which a short recording has few."""
RIDGE = 1e-9


class Slope(NamedTuple):
    """A number's values at both ends of what was fitted, the share of the cost that its slope
    takes, and that advantage in block scatter."""

    first: float
    last: float
    taken: float
    z: float

    @property
    def is_there(self) -> bool:
        """Whether one value does not do."""
        mean = 0.5 * abs(self.first + self.last)
        changed = abs(self.last - self.first) > CHANGED * mean
        return changed and self.taken > TAKEN and self.z > BEYOND_Z


def slope_of(found: Found, name: str) -> Slope:
    """Of one of the numbers that were sought; ValueError for another name."""
    k = [unknown.name for unknown in found.unknowns].index(name)
    white = found.errors.white(found.sigma)
    rows = np.column_stack([found.jacobian, found.jacobian[:, k] * _time(found)])
    moved, slope = _step(found, rows, white)
    with_slope, without = _costs(found, white + rows @ moved), _costs(found, white)
    taken = 1.0 - float(with_slope.sum()) / max(float(without.sum()), 1e-300)
    value = float(found.values[k])
    return Slope(value - slope, value + slope, taken, block_z(with_slope, without))


def _costs(found: Found, white: Array) -> Array:
    """By block."""
    by_point = robust_cost(white).reshape(found.errors.rows.shape).sum(axis=0)
    return np.bincount(found.errors.group, by_point).astype(np.float64)


def _time(found: Found) -> Array:
    """Of every whitened point, -1 at the first that is known and 1 at the last."""
    known = np.isfinite(found.errors.rows).any(axis=0)
    group = found.errors.group.astype(np.float64)
    first, last = group[known].min(), group[known].max()
    time = np.clip(2.0 * (group - first) / max(last - first, 1.0) - 1.0, -1.0, 1.0)
    return np.tile(time, found.errors.rows.shape[0])


def _step(found: Found, rows: Array, white: Array) -> tuple[Array, float]:
    """What all numbers do as the slope in the last place grows to its best; that slope alone."""
    weighted = rows / np.sqrt(1.0 + (white / KNEE) ** 2)[:, None]
    believed = np.array([*(u.deviation**-2.0 for u in found.unknowns), 0.0])
    gram = rows.T @ weighted + np.diag(believed)
    size = np.sqrt(np.diag(gram))
    size = np.where(size > 0.0, size, 1.0)
    scaled = gram / np.outer(size, size) + RIDGE * np.eye(size.size)
    pull = np.zeros(size.size)
    pull[-1] = -float(weighted[:, -1] @ white) / size[-1]
    moved = np.linalg.solve(scaled, pull) / size
    return moved, float(moved[-1])
