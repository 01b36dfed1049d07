"""The prior of the kernels' elements, and its evidence on one period of an M-sequence.

Every element of order m is independent, zero-mean Gaussian with variance

    v(S) = prod_{i in S} lambda_m(i)        log lambda_m piecewise linear in the lag

so a kernel decays as its weights do, each order in its own way. On a whole period the elements
fall on N orthogonal shifts, where they add: with w(k) = sum of v over the elements on shift k and
white noise of variance s, a measured coefficient is N(0, w(k) + s). The evidence of all
hyper-parameters is therefore a sum over shifts, and w comes from one M-transform of

    f(t) = sum_m e_m(lambda_m u_t),        exactly and for every order (`elementary`).

This is Gaussian-process regression on the multilinear kernel f, without its N x N matrix.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, minimize

from servo_bench.estimators.elementary import elementary_gradient, elementary_sums
from servo_bench.estimators.spectrum import Spectrum

Array = NDArray[np.float64]

KNOTS = 8
STEPS = 400
LARGEST_LOG = 25.0
"""Bound of a log weight to either side of its start: beyond, an order is off or is all noise."""


@dataclass(frozen=True, slots=True, eq=False)
class DecayPrior:
    """Weights lambda, shape (orders, memory), and the noise variance of a coefficient."""

    orders: tuple[int, ...]
    weights: Array
    noise_variance: float

    def shift_variances(self, spectrum: Spectrum, lags: Array) -> Array:
        """w(k) + s, shape (N,)."""
        places = elementary_sums(lags, self.weights, np.array(self.orders))
        return np.maximum(spectrum.shifts_of(places), 0.0) + self.noise_variance

    def element_variances(self, order: int, sets: NDArray[np.intp]) -> Array:
        """v of each row of lags, shape (sets, order) -> (sets,); zero for an order not modelled."""
        if order not in self.orders:
            return np.zeros(len(sets))
        weight = self.weights[self.orders.index(order)]
        variances: Array = np.prod(weight[sets], axis=1)
        return variances


def fitted_prior(
    coefficients: Array, spectrum: Spectrum, memory: int, orders: tuple[int, ...]
) -> DecayPrior:
    """The prior with the largest evidence for measured coefficients, shape (N,)."""
    lags = spectrum.lags(memory)
    order_array = np.array(orders)
    knots = np.unique(np.rint(np.geomspace(1, memory, KNOTS)).astype(np.intp)) - 1
    basis = np.stack([np.interp(np.arange(memory), knots, row) for row in np.eye(knots.size)])

    def weights_of(logs: Array) -> Array:
        return np.asarray(np.exp(logs.reshape(len(orders), knots.size) @ basis))

    def cost(logs: Array) -> tuple[float, Array]:
        weights, noise = weights_of(logs[1:]), float(np.exp(logs[0]))
        places = elementary_sums(lags, weights, order_array)
        variance = np.maximum(spectrum.shifts_of(places), 0.0) + noise
        slope = 0.5 * (1.0 - coefficients**2 / variance) / variance
        outer = spectrum.places_of(slope)
        by_weight = elementary_gradient(lags, weights, order_array, outer) @ basis.T
        value = 0.5 * float(np.sum(np.log(variance) + coefficients**2 / variance))
        return value, np.concatenate([[slope.sum() * noise], by_weight.ravel()])

    energy = max(float(np.sum(coefficients**2)), np.finfo(float).tiny)
    begin = [np.array([np.log(energy * 1e-4)])]
    begin += [np.log(0.2 * energy ** (1.0 / order)) - 0.35 * knots for order in orders]
    start = np.concatenate(begin)
    bounds = Bounds(start - LARGEST_LOG, start + 5.0)
    found = minimize(
        cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": STEPS}
    )
    return DecayPrior(orders, weights_of(found.x[1:]), float(np.exp(found.x[0])))
