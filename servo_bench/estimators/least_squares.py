"""Least squares on the terms that the input can identify.

The terms are products of lags up to an order. How often a lag may occur in one follows from the
number of distinct levels that were played (binary: once); see `kernels.terms`.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from servo_bench.errors import FitError
from servo_bench.estimators.data import Array, Parameter, Training, lagged
from servo_bench.kernels.terms import Term, fit_terms, identifiable_terms, term_columns

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
        found = fit_terms(term_columns(rows, terms), training.response)
        covariance = found.noise_variance * found.unit_covariance
        values = found.values
        return LeastSquaresFit(self.memory, training.amplitude, terms, values, covariance)


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
        blocks = [term_columns(rows[i : i + BLOCK], self.terms) for i in range(0, len(rows), BLOCK)]
        return np.concatenate([np.zeros(0), *(block @ self.values for block in blocks)])

    def standard_deviation(self, inputs: Array, history: Array | None = None) -> Array:
        """From the covariance of the coefficients."""
        rows = lagged(inputs, history, self.memory) / self.amplitude
        columns = term_columns(rows, self.terms)
        variance = np.einsum("ti,ti->t", columns @ self.covariance, columns)
        return np.asarray(np.sqrt(variance))
