"""Regularised Volterra: all orders up to 7 at once, each element shrunk by a decay prior.

On whole periods of a binary M-sequence the posterior is exact without any matrix
(`decay_prior`): with c(k) measured, v(S) the prior variance of an element and w(k) of its shift,

    E[c_S] = v(S) c(k) / (w(k) + s)        var[c_S] = v(S) - v(S)^2 / (w(k) + s)

so elements that share a shift share its coefficient by what the prior expects of each, and their
variances say that they were not told apart. On any other input the polynomial prior takes over
(`polynomial_prior`), which has diagonals too.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import FitError
from servo_bench.estimators.data import Array, Parameter, Predictor, Training, lagged
from servo_bench.estimators.decay_prior import DecayPrior, fitted_prior
from servo_bench.estimators.elementary import elementary_products, elementary_sums
from servo_bench.estimators.polynomial_prior import PolynomialPrior
from servo_bench.estimators.spectrum import Spectrum
from servo_bench.kernels.correlate import cross_correlation
from servo_bench.kernels.shifts import element_shifts, lag_sets

ORDERS = (1, 2, 3, 5, 7)
BLOCK = 256


@dataclass(frozen=True, slots=True)
class RegularisedVolterra:
    """`memory` in samples. Orders are those of the multilinear prior; 4 and 6 are left out."""

    memory: int = 30
    orders: tuple[int, ...] = ORDERS

    def fit(self, training: Training) -> Predictor:
        """The posterior of all elements; FitError where the response does not vary."""
        if np.ptp(training.response) == 0.0:
            raise FitError(
                "the response is constant: there is nothing to estimate. Check that the rig moved "
                "and that the recorded channel is its response."
            )
        if training.polynomial is None:
            return PolynomialPrior(self.memory).fit(training)
        spectrum = Spectrum(training.polynomial)
        phi = cross_correlation(training.response, training.polynomial)
        chips = phi.size
        baseline = float(np.median(phi))
        coefficients = (phi - baseline) * chips / (chips + 1)
        prior = fitted_prior(coefficients, spectrum, self.memory, self.orders)
        constant = (float(training.response.mean()) - baseline) * chips / (chips + 1)
        return MultilinearPosterior(spectrum, training.amplitude, coefficients, constant, prior)


@dataclass(frozen=True, eq=False)
class MultilinearPosterior:
    """What a period taught about every element, and what that predicts.

    `coefficients` are c(k) of the shifts, shape (N,), `constant` is c0.
    """

    spectrum: Spectrum
    amplitude: float
    coefficients: Array
    constant: float
    prior: DecayPrior

    @property
    def memory(self) -> int:
        """Lags 0 to memory - 1."""
        return int(self.prior.weights.shape[1])

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """The constant, and what the evidence says of the noise of a response sample."""
        chips = self.coefficients.size
        return {
            "constant": Parameter(self.constant, float(np.sqrt(self.prior.noise_variance))),
            "noise": Parameter(float(np.sqrt(self.prior.noise_variance * chips)), float("nan")),
        }

    def element(self, order: int) -> tuple[Array, Array]:
        """Mean and standard deviation of c1, c2, or c3 over `lag_sets(memory, order)`."""
        shifts = element_shifts(self.spectrum.polynomial, self.memory, order)
        prior = self.prior.element_variances(order, lag_sets(self.memory, order))
        mean: Array = prior * (self.coefficients / self._variances)[shifts]
        left = np.maximum(prior - prior**2 / self._variances[shifts], 0.0)
        return mean, np.sqrt(left)

    def predict(self, inputs: Array, history: Array | None = None) -> Array:
        """The posterior mean; input beyond +-amplitude is the multilinear form continued."""
        scaled = self._lagged(inputs, history)
        blocks = [self._covariances(rows) @ self._dual for rows in _blocks(scaled)]
        return self.constant + np.concatenate([np.zeros(0), *blocks])

    def standard_deviation(self, inputs: Array, history: Array | None = None) -> Array:
        """Of the posterior, without the noise of a measurement."""
        scaled = self._lagged(inputs, history)
        orders = np.array(self.prior.orders)
        before = elementary_sums(scaled**2, self.prior.weights, orders)
        told = [
            np.sum(self.spectrum.shifts_of(self._covariances(rows)) ** 2 / self._variances, axis=1)
            for rows in _blocks(scaled)
        ]
        return np.asarray(np.sqrt(np.maximum(before - np.concatenate([np.zeros(0), *told]), 0.0)))

    def _lagged(self, inputs: Array, history: Array | None) -> Array:
        return lagged(inputs, history, self.memory) / self.amplitude

    def _covariances(self, rows: Array) -> Array:
        orders = np.array(self.prior.orders)
        return elementary_products(rows, self._places, self.prior.weights, orders)

    @cached_property
    def _places(self) -> Array:
        return self.spectrum.lags(self.memory)

    @cached_property
    def _variances(self) -> Array:
        return self.prior.shift_variances(self.spectrum, self._places)

    @cached_property
    def _dual(self) -> Array:
        return self.spectrum.places_of(self.coefficients / self._variances)


def _blocks(rows: NDArray[np.float64]) -> list[Array]:
    return [rows[start : start + BLOCK] for start in range(0, len(rows), BLOCK)]
