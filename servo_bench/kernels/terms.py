"""Products of lags as columns of a linear fit: which ones an input can identify, and their fit.

On L distinct levels u^L is a polynomial of lower degree, so a lag that occurs L times or more in a
product brings nothing new. Products whose columns still depend on each other are refused, not
split.
"""

from collections import Counter
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from servo_bench.errors import FitError

Array = NDArray[np.float64]
Term = tuple[int, ...]

SMALLEST_PIVOT = 1e-11
"""Of the Gram matrix of columns of length one: below, a column is a sum of the others."""


def identifiable_terms(memory: int, order: int, levels: int) -> tuple[Term, ...]:
    """Every product of at most `order` lags, none more than `levels` - 1 times; () is 1."""
    return tuple(
        lags
        for m in range(order + 1)
        for lags in combinations_with_replacement(range(memory), m)
        if all(count < levels for count in Counter(lags).values())
    )


def term_columns(rows: Array, terms: tuple[Term, ...]) -> Array:
    """Each term at each row of lagged inputs, shape (n, terms); every part of a term is one too."""
    place = {term: index for index, term in enumerate(terms)}
    columns = np.empty((len(terms), len(rows)))
    lags = np.ascontiguousarray(rows.T)
    for index, term in enumerate(terms):
        columns[index] = columns[place[term[:-1]]] * lags[term[-1]] if term else 1.0
    return np.ascontiguousarray(columns.T)


@dataclass(frozen=True, slots=True, eq=False)
class TermFit:
    """Coefficient of each column, their covariance for noise of variance one, and that noise's."""

    values: Array
    unit_covariance: Array
    noise_variance: float


def fit_terms(columns: Array, response: Array) -> TermFit:
    """Least squares; FitError where columns outnumber samples or depend on each other."""
    samples, terms = columns.shape
    if terms >= samples:
        raise FitError(
            f"{terms} terms cannot be fitted to {samples} samples. Use a shorter memory, a lower "
            f"order, or more samples."
        )
    factor, pivots, rank, length = _factored(columns)
    if rank < terms:
        raise FitError(
            f"{terms - rank} of {terms} terms are sums of others on this input: no estimator can "
            f"tell them apart. Use a shorter memory, a lower order, or a longer sequence."
        )
    inverse = np.empty((terms, terms))
    inverse[np.ix_(pivots, pivots)] = linalg.cho_solve((factor, True), np.eye(terms))
    inverse /= np.outer(length, length)
    values = inverse @ (columns.T @ response)
    values += inverse @ (columns.T @ (response - columns @ values))
    left = response - columns @ values
    return TermFit(np.asarray(values), inverse, float(left @ left) / (samples - terms))


def dependent_terms(columns: Array) -> int:
    """How many columns are sums of the others."""
    return int(columns.shape[1]) - _factored(columns)[2]


def _factored(columns: Array) -> tuple[Array, NDArray[np.intp], int, Array]:
    """Pivoted Cholesky of the Gram matrix of columns of length one: L, order, rank, lengths."""
    length = np.sqrt(np.maximum(np.einsum("ti,ti->i", columns, columns), np.finfo(float).tiny))
    scaled = columns / length
    factor, pivots, rank, _ = linalg.lapack.dpstrf(scaled.T @ scaled, tol=SMALLEST_PIVOT, lower=1)
    return factor, np.asarray(pivots, np.intp) - 1, int(rank), length
