"""Increments between means: from the mean of some points to that of the next ones.

    h_k = (mean of v over [m, e) - mean over [b, m)) / (mean of t there - mean of t here)

A sensor's white noise falls with the square root of how many rows a mean has. Neighbours overlap by
half, and none reaches over a row whose time is not known. Means are over the samples that came, no
fewer than half of them, of what is simulated too. What does not depend on the values is kept: a
search compares some thousand models with one recording. Source: Haar, Math. Ann. 69 (1910).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from servo_bench.diagnosis.comparing.rows import Array, Mask, Rows

SHORTEST_S = 1e-9
"""Between two samples: a device that read two commands at once gives them one time."""


class Haar(NamedTuple):
    """The increments of one signal in one piece: at which of its `points` they stand, the rows that
    bound their halves, how many samples came in each, and how far apart their means are; which
    are `known`, and which samples `came`."""

    points: int
    at: NDArray[np.intp]
    bounds: tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]
    early: Array
    late: Array
    elapsed_s: Array
    known: Mask
    came: Mask

    def of(self, values: Array) -> Array:
        """The increments of values, shape (rows,), at the points; NaN where there is none."""
        found = np.full(self.points, np.nan)
        if self.at.size:
            total = _sums(values, self.came)
            begin, middle, end = (total[bound] for bound in self.bounds)
            means = (middle - begin) / self.early, (end - middle) / self.late
            found[self.at] = np.where(self.known, (means[1] - means[0]) / self.elapsed_s, np.nan)
        return found


def haar_of(rows: Rows, first: int, edges: NDArray[np.intp], stride: int, came: Mask) -> Haar:
    """Of the piece from row `first`, whose points lie between `edges`, where these samples came."""
    points = max(edges.size - 1, 0)
    at = np.arange(0, points - 2 * stride + 1, max(stride // 2, 1))
    begin, middle, end = edges[at], edges[at + stride], edges[at + 2 * stride]
    unknown = np.concatenate(([0], np.cumsum(~rows.timed)))
    known = unknown[end] == unknown[begin]
    count = _sums(came.astype(np.float64), came)
    total_s = _sums(rows.t_s[first : first + came.size], came)
    many, mean_s = [], []
    for low, high in ((begin - first, middle - first), (middle - first, end - first)):
        many.append(np.maximum(count[high] - count[low], 1.0))
        known = known & (count[high] - count[low] >= 0.5 * (high - low))
        mean_s.append((total_s[high] - total_s[low]) / many[-1])
    return Haar(
        points=points,
        at=at,
        bounds=(begin - first, middle - first, end - first),
        early=many[0],
        late=many[1],
        elapsed_s=np.maximum(mean_s[1] - mean_s[0], SHORTEST_S),
        known=known,
        came=came,
    )


def _sums(values: Array, came: Mask) -> Array:
    """Cumulative sum of what came, from zero."""
    total = np.zeros(values.size + 1)
    np.cumsum(np.where(came, values, 0.0), out=total[1:])
    return total
