"""How much of an error repeats with something: shares of its variance, from 0 to 1.

    velocity, current    its mean in bins that hold as many points each
    position             a line  a cos(n theta) + b sin(n theta),  as it is, or times the direction
    edge                 a linear filter of the command's jumps, over the last 24 rows
    drift                a parabola in time

Every share is what is left after chance has its part: p free numbers explain p/n of any noise,

    share = (R^2 - p/n)/(1 - p/n),    never below 0.

Nothing here knows a model of the cause.
"""

from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.rows import Array, Mask

BINS = 40
AFTER_ROWS = 24
ORDERS = np.arange(1.0, 101.0)
LEAST_PERIODS = 1.0


class Binned(NamedTuple):
    """Mean and scatter in bins of something; shape (bins,)."""

    at: Array
    mean: Array
    scatter: Array


def beyond_chance(explained: float, total: float, numbers: float, points: int) -> float:
    """The share that `numbers` free numbers explain of `points` points, less what chance has."""
    if total <= 0.0 or points <= numbers:
        return 0.0
    chance = numbers / points
    return float(np.clip((explained / total - chance) / (1.0 - chance), 0.0, 1.0))


def binned(by: Array, error: Array, bins: int = BINS) -> Binned:
    """The error in bins of `by` that hold as many points each."""
    rows = [r for r in np.array_split(np.argsort(by, kind="stable"), bins) if r.size]
    return Binned(
        np.array([by[r].mean() for r in rows]),
        np.array([error[r].mean() for r in rows]),
        np.array([error[r].std() for r in rows]),
    )


def binned_share(by: Array, error: Array, bins: int = BINS) -> float:
    """Of the variance, by the mean in bins of `by`."""
    centred = error - error.mean()
    total = float(centred @ centred)
    rows = [r for r in np.array_split(np.argsort(by, kind="stable"), bins) if r.size]
    explained = sum(r.size * float(centred[r].mean()) ** 2 for r in rows)
    return beyond_chance(explained, total, len(rows) - 1.0, error.size)


def line_shares(angle: Array, error: Array, weight: Array | None = None) -> Array:
    """Of the variance, by a wave of each of ORDERS times `weight`; shape (orders,).

    An order that made less than one period is not told from drift: its share is 0.
    """
    shares = np.zeros(ORDERS.size)
    if not angle.size:
        return shares
    centred = error - error.mean()
    total = float(centred @ centred)
    periods = ORDERS * float(np.ptp(angle)) / (2.0 * np.pi)
    factor = np.ones(angle.size) if weight is None else weight
    for k in np.flatnonzero(periods >= LEAST_PERIODS):
        wave = np.exp(1j * ORDERS[k] * angle)
        terms = np.stack((wave.real, wave.imag)) * factor
        terms -= terms.mean(axis=1, keepdims=True)
        seen = terms @ centred
        explained = float(seen @ np.linalg.lstsq(terms @ terms.T, seen, rcond=None)[0])
        shares[k] = beyond_chance(explained, total, 2.0, error.size)
    return shares


def after_edges(jumps: Array, error: Array, known: Mask) -> tuple[Array, float]:
    """The mean error so many rows after a jump of 1 rad/s, and the share that it explains.

    `jumps` and `error` row by row, shape (rows,); returns ((AFTER_ROWS,), share).
    """
    rows = np.flatnonzero(known)
    rows = rows[rows >= AFTER_ROWS]
    if rows.size < 4 * AFTER_ROWS:
        return np.zeros(AFTER_ROWS), 0.0
    past = jumps[rows[:, None] - np.arange(AFTER_ROWS)]
    centred = error[rows] - error[rows].mean()
    past = past - past.mean(axis=0)
    answer = np.linalg.lstsq(past, centred, rcond=1e-6)[0]
    left = centred - past @ answer
    total = float(centred @ centred)
    explained = total - float(left @ left)
    return np.asarray(answer), beyond_chance(explained, total, AFTER_ROWS, rows.size)


def drift_share(time_s: Array, error: Array) -> float:
    """Of the variance, by a parabola in time."""
    centred = error - error.mean()
    place = np.linspace(-1.0, 1.0, time_s.size) if np.ptp(time_s) == 0.0 else time_s
    fitted = np.polynomial.Polynomial.fit(place, centred, 2)(place)
    left = centred - fitted
    total = float(centred @ centred)
    return beyond_chance(total - float(left @ left), total, 2.0, error.size)
