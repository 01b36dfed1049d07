"""Kernels up to order 3 from a sequence of three levels (GF(3)) or five (GF(5)).

With more than two levels u^2 is no constant, so products in which a lag comes twice are there too:

    y(t) = c0 + sum c1(i) u(t-i) + sum_{i<=j} c2(i,j) u u + sum_{i<=j<=k} c3(i,j,k) u u u

fitted by least squares, for such products are not orthogonal. In the symmetric kernels

    c2(i,i) = A^2 g2(i,i)      c3(i,i,k) = 3 A^3 g3(i,i,k)      c3(i,i,i) = A^3 g3(i,i,i)

A chip later than the polynomial's degree is a sum (mod p) of earlier ones, which on a sparse
polynomial is itself a product of order 3: the memory that can be resolved is short, and a rig that
remembers longer is aliased into what is found.

On three levels u^3 = u: g3(i,i,i) is not identifiable, and c1 = A g1 + A^3 g3(i,i,i). On five all
of them are told apart (orders from 5 on fold, u^5 = (5 u^3 - u)/4).
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import FitError
from servo_bench.excitation.fields import field_sequence
from servo_bench.kernels.settled import refuse_integrator
from servo_bench.kernels.terms import (
    dependent_terms,
    fit_terms,
    identifiable_terms,
    term_columns,
)
from servo_bench.kernels.volterra import Kernels

Array = NDArray[np.float64]
ORDER = 3
LONGEST = 16
ENOUGH_ROWS = 8192
"""Memory that is looked at, and samples on which a dependence shows."""


def extract_levels(
    response_periods: Array,
    chips: Array,
    polynomial: str,
    amplitude: float,
    memory: int,
    *,
    period_s: float = 1.0,
) -> Kernels:
    """Kernels from whole periods in steady state, shape (N,) or (periods, N).

    `chips` is one period, within +-1. `scatter` is the error of a linear coefficient by what the
    fit leaves over (noise, memory beyond M, orders 5 and above), `standard_error` by the spread
    between periods. FitError where the response is not whole periods, not finite, or an angle, or
    where the terms are too many or depend on each other.
    """
    periods = np.atleast_2d(np.asarray(response_periods, np.float64))
    if periods.ndim != 2 or periods.shape[1] != chips.size or not np.isfinite(periods).all():
        raise FitError(
            f"the response has shape {np.shape(response_periods)}, or samples that are not "
            f"numbers: a period of {polynomial} has {chips.size}. Cut it to whole periods."
        )
    levels = np.unique(chips).size
    limit = level_memory(levels, polynomial)
    if not 1 <= memory <= limit:
        raise FitError(
            f"memory {memory} is beyond what {polynomial} over GF({levels}) can resolve up to "
            f"order {ORDER}: from {limit + 1} samples on some products of lags are sums of others, "
            f"and no estimator can tell them apart. Use a memory of 1 to {limit}, another "
            f"polynomial or a higher degree, or an estimator with a model (grey-box, play)."
        )
    mean = periods.mean(axis=0)
    linear = linear_answer(mean, chips)
    inside = np.arange(chips.size) < memory
    refuse_integrator(linear, ~inside, float(np.abs(linear[inside]).max()))
    terms = identifiable_terms(memory, ORDER, levels)
    rows = _rows(chips, memory)
    found = fit_terms(term_columns(rows, terms), mean)
    coefficients = [np.zeros((memory,) * m) for m in range(ORDER + 1)]
    for term, value in zip(terms, found.values, strict=True):
        coefficients[len(term)][term] = value
    for array in coefficients:
        array.setflags(write=False)
    gain = float(np.sqrt(np.mean(np.diag(found.unit_covariance)[1 : memory + 1])))
    scatter = gain * float(np.sqrt(found.noise_variance))
    return Kernels(
        polynomial=polynomial,
        amplitude=amplitude,
        memory=memory,
        order=ORDER,
        period_s=period_s,
        periods=len(periods),
        baseline=0.0,
        constant=float(coefficients[0]),
        c1=coefficients[1],
        c2=coefficients[2],
        c3=coefficients[3],
        scatter=scatter,
        scatter_rms=scatter,
        scatter_kurtosis=3.0,
        standard_error=_between(periods) * gain if len(periods) > 1 else None,
        levels=levels,
    )


@cache
def level_memory(field: int, polynomial: str) -> int:
    """The longest memory in which no product of up to three lags is a sum of others."""
    chips = field_sequence(field, polynomial)
    for memory in range(2, LONGEST + 1):
        terms = identifiable_terms(memory, ORDER, field)
        rows = _rows(chips, memory)[:ENOUGH_ROWS]
        if len(terms) >= len(rows) or dependent_terms(term_columns(rows, terms)):
            return memory - 1
    return LONGEST


def _rows(chips: Array, memory: int) -> Array:
    return np.stack([np.roll(chips, lag) for lag in range(memory)], axis=1)


def linear_answer(mean: Array, chips: Array) -> Array:
    """The linear coefficient of every shift, (N,), its median taken off: good to a few percent."""
    spectrum = np.fft.rfft(mean) * np.conj(np.fft.rfft(chips))
    phi = np.fft.irfft(spectrum, chips.size) / float(chips @ chips)
    return np.asarray(phi - np.median(phi))


def _between(periods: Array) -> float:
    """Standard deviation of the mean period's samples by the spread between periods."""
    return float(np.sqrt(np.mean(np.var(periods, axis=0, ddof=1)) / len(periods)))
