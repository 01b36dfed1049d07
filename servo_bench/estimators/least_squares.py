"""Least squares on the terms that the input can identify.

The terms are products of lags up to an order. How often a lag may occur in one follows from the
number L of distinct levels that were played: u^L is a polynomial of lower degree on them, so
powers above L - 1 are left out (binary: every lag once). Terms whose columns still depend on each
other are refused, not split.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy import linalg

from servo_bench.errors import FitError
from servo_bench.estimators.data import Array, Parameter, Training, lagged

Term = tuple[int, ...]

SMALLEST_PIVOT = 1e-9
BLOCK = 4096


@dataclass(frozen=True, slots=True)
class LeastSquares:
    """Memory in samples and the highest order."""

    memory: int = 14
    order: int = 3

    def fit(self, training: Training) -> "LeastSquaresFit":
        """FitError where terms outnumber samples or cannot be told apart on this input."""
        levels = np.unique(np.round(training.inputs / np.abs(training.inputs).max(), 9)).size
        terms = identifiable_terms(self.memory, self.order, levels)
        rows = lagged(training.inputs, training.history, self.memory) / training.amplitude
        if len(terms) >= len(rows):
            raise FitError(
                f"{len(terms)} terms (memory {self.memory}, order {self.order}) cannot be fitted "
                f"to {len(rows)} samples. Use a shorter memory, a lower order, or more samples."
            )
        columns = _columns(rows, terms)
        r, _ = linalg.qr(columns, mode="r", pivoting=True, check_finite=False)
        pivots = np.abs(np.diag(r))
        dependent = int(np.count_nonzero(pivots < SMALLEST_PIVOT * pivots[0]))
        if dependent:
            raise FitError(
                f"{dependent} of {len(terms)} terms are sums of others on this input: no "
                f"estimator can tell them apart. Use a shorter memory than {self.memory}, a lower "
                f"order, or a longer sequence."
            )
        gram = linalg.cho_factor(columns.T @ columns, lower=True)
        values = np.asarray(linalg.cho_solve(gram, columns.T @ training.response))
        left = training.response - columns @ values
        noise = float(left @ left) / (len(rows) - len(terms))
        covariance = noise * np.asarray(linalg.cho_solve(gram, np.eye(len(terms))))
        return LeastSquaresFit(self.memory, training.amplitude, terms, values, covariance)


def identifiable_terms(memory: int, order: int, levels: int) -> tuple[Term, ...]:
    """Every product of at most `order` lags, none more than `levels` - 1 times; () is 1."""
    return tuple(
        lags
        for m in range(order + 1)
        for lags in combinations_with_replacement(range(memory), m)
        if all(count < levels for count in Counter(lags).values())
    )


@dataclass(frozen=True, slots=True, eq=False)
class LeastSquaresFit:
    """A coefficient for every term, of inputs in units of the amplitude, and their covariance."""

    memory: int
    amplitude: float
    terms: tuple[Term, ...]
    values: Array
    covariance: Array

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """By the lags of the term, `c_0_3` for u(t) u(t-3)."""
        errors = np.sqrt(np.diag(self.covariance))
        return {
            "_".join(["c", *map(str, term)]): Parameter(float(value), float(error))
            for term, value, error in zip(self.terms, self.values, errors, strict=True)
        }

    def predict(self, inputs: Array, history: Array | None = None) -> Array:
        """The sum of the terms."""
        rows = lagged(inputs, history, self.memory) / self.amplitude
        blocks = [_columns(rows[i : i + BLOCK], self.terms) for i in range(0, len(rows), BLOCK)]
        return np.concatenate([np.zeros(0), *(block @ self.values for block in blocks)])

    def standard_deviation(self, inputs: Array, history: Array | None = None) -> Array:
        """From the covariance of the coefficients."""
        rows = lagged(inputs, history, self.memory) / self.amplitude
        columns = _columns(rows, self.terms)
        variance = np.einsum("ti,ti->t", columns @ self.covariance, columns)
        return np.asarray(np.sqrt(variance))


def _columns(rows: Array, terms: tuple[Term, ...]) -> Array:
    """Each term at each row, shape (n, terms); a term is an earlier one times a lag."""
    place = {term: index for index, term in enumerate(terms)}
    columns = np.empty((len(terms), len(rows)))
    lags = np.ascontiguousarray(rows.T)
    for index, term in enumerate(terms):
        columns[index] = columns[place[term[:-1]]] * lags[term[-1]] if term else 1.0
    return np.ascontiguousarray(columns.T)
