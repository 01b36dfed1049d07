"""The circular cross-correlation of an M-sequence and the response to it, exact over the period.

phi(k) = (1/N) sum_t u(t - k) y(t)        k = 0 .. N - 1
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import FitError
from servo_bench.excitation.msequence import m_sequence
from servo_bench.kernels.transform import m_transform

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Correlation:
    """phi, shape (N,); the response's mean; how many periods; phi's standard error or None."""

    phi: Array
    mean: float
    periods: int
    standard_error: float | None


def cross_correlation(response: Array, polynomial: str) -> Array:
    """phi of a response to whole periods, shape (..., N) -> (..., N)."""
    chips = m_sequence(polynomial).size
    rows = np.reshape(response, (-1, chips))
    sums = [m_transform(row, polynomial) for row in rows]
    return np.reshape(sums, np.shape(response)) / chips


def averaged_correlation(response_periods: Array, polynomial: str) -> Correlation:
    """phi of the mean of several periods, shape (N,) or (periods, N).

    White noise spreads evenly over the shifts, so its standard error is one figure: that of the
    differences between periods, which a periodic response and its aliases drop out of.
    FitError where the response is not whole periods or not finite.
    """
    chips = m_sequence(polynomial).size
    periods = np.atleast_2d(np.asarray(response_periods, np.float64))
    if periods.ndim != 2 or periods.shape[1] != chips or periods.shape[0] < 1:
        raise FitError(
            f"the response has shape {np.shape(response_periods)}: {polynomial} has periods of "
            f"{chips} samples, so ({chips},) or (periods, {chips}) is needed. Cut the response to "
            f"whole periods."
        )
    if not np.isfinite(periods).all():
        raise FitError(
            f"{np.count_nonzero(~np.isfinite(periods))} samples of the response are not numbers. "
            f"Bridge the gaps before extracting kernels, or record again."
        )
    mean = periods.mean(axis=0)
    count = periods.shape[0]
    error = None
    if count > 1:
        variance = float(periods.var(axis=0, ddof=1).mean())
        error = float(np.sqrt(variance / (count * chips)))
    return Correlation(cross_correlation(mean, polynomial), float(mean.mean()), count, error)
