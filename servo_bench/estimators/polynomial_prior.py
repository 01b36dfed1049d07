"""Regularised Volterra on any input: a Gaussian process with a decaying polynomial covariance.

    y(t) = sum_m f_m(u_t) + noise           cov f_m = s_m p^m,   p(u, u') = sum_i l^i u_i u'_i / P

Power m of p holds every symmetric element of order m, diagonals too, with a variance that decays
with each lag; P makes p = 1 on average. The hyper-parameters (decay l, strengths s_m, noise) have
the largest marginal likelihood of a subset of the samples, drawn from the training; the posterior
takes all of them, in O(n^2) memory.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import linalg
from scipy.optimize import Bounds, minimize

from servo_bench.errors import FitError
from servo_bench.estimators.data import Array, Parameter, Training, lagged

ORDERS = (0, 1, 2, 3, 5)
SUBSET = 800
SUBSET_SEED = 0
STEPS = 60
LARGEST_SAMPLES = 12_000
"""Beyond, the covariance matrix passes 1.2 GB."""


@dataclass(frozen=True, slots=True)
class PolynomialPrior:
    """`memory` in samples, `orders` of the kernels, `subset` samples for the evidence."""

    memory: int = 20
    orders: tuple[int, ...] = ORDERS
    subset: int = SUBSET

    def fit(self, training: Training) -> "PolynomialPosterior":
        """The posterior; FitError where the samples are too many for memory, or too few."""
        count = training.inputs.size
        if not self.memory < count <= LARGEST_SAMPLES:
            raise FitError(
                f"{count} samples were given: this estimator takes more than its memory "
                f"({self.memory}) and at most {LARGEST_SAMPLES}. Cut the training, or play whole "
                f"periods of one M-sequence, whose estimate needs no matrix."
            )
        rows = lagged(training.inputs, training.history, self.memory)
        constant = float(training.response.mean())
        centred = training.response - constant
        logs = self._most_likely(rows, centred)
        covariance = _Covariance(self.orders, self.memory, float(np.var(training.inputs)), logs)
        matrix = covariance.of(rows, rows)
        matrix[np.diag_indices_from(matrix)] += covariance.noise_variance
        factor = linalg.cholesky(matrix, lower=True, overwrite_a=True, check_finite=False)
        dual = np.asarray(linalg.cho_solve((factor, True), centred, check_finite=False))
        return PolynomialPosterior(constant, rows, covariance, factor, dual)

    def _most_likely(self, rows: Array, response: Array) -> Array:
        """log noise, log decay rate, log strengths."""
        power = float(np.mean(rows**2))
        drawn = np.random.default_rng(SUBSET_SEED).permutation(len(rows))[: self.subset]
        some, seen = rows[drawn], response[drawn]
        variance = max(float(np.var(seen)), np.finfo(float).tiny)

        def cost(logs: Array) -> tuple[float, Array]:
            covariance = _Covariance(self.orders, self.memory, power, logs)
            return _evidence(covariance, some, seen)

        strengths = np.full(len(self.orders), np.log(0.5 * variance))
        start = np.concatenate([np.log(np.array([0.1 * variance, 0.3])), strengths])
        reach = np.array([15.0, 3.0, *(12.0 for _ in self.orders)])
        bounds = Bounds(start - reach, start + np.minimum(reach, 6.0))
        found = minimize(
            cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": STEPS}
        )
        return np.asarray(found.x)


@dataclass(frozen=True, slots=True, eq=False)
class _Covariance:
    """cov f for given hyper-parameters: log noise variance, log decay rate, log strengths."""

    orders: tuple[int, ...]
    memory: int
    power: float
    logs: Array
    noise_variance: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "noise_variance", float(np.exp(self.logs[0])))

    def weights(self) -> Array:
        """The variance of each lag; they sum to 1 / power, so p is 1 on average."""
        decay: Array = np.exp(-np.exp(self.logs[1]) * np.arange(self.memory))
        weights: Array = decay / (decay.sum() * self.power)
        return weights

    def of(self, left: Array, right: Array) -> Array:
        """cov f between two sets of inputs, (n, M) and (k, M) -> (n, k)."""
        return self.sum_of_powers((left * self.weights()) @ right.T)

    def sum_of_powers(self, p: Array) -> Array:
        """sum_m s_m p^m."""
        total = np.zeros_like(p)
        for strength, order in zip(np.exp(self.logs[2:]), self.orders, strict=True):
            total += strength * p**order
        return total


def _evidence(covariance: _Covariance, rows: Array, response: Array) -> tuple[float, Array]:
    """-log marginal likelihood and its gradient by the log hyper-parameters."""
    weights = covariance.weights()
    p = (rows * weights) @ rows.T
    matrix = covariance.sum_of_powers(p)
    matrix[np.diag_indices_from(matrix)] += covariance.noise_variance
    try:
        factor = linalg.cholesky(matrix, lower=True, check_finite=False)
    except linalg.LinAlgError:
        return 1e25, np.zeros(covariance.logs.size)
    inverse = linalg.cho_solve((factor, True), np.eye(len(rows)), check_finite=False)
    dual = inverse @ response
    value = 0.5 * float(response @ dual) + float(np.sum(np.log(np.diag(factor))))
    outer = 0.5 * (inverse - np.outer(dual, dual))
    lag = np.arange(rows.shape[1])
    mean_lag = float(weights @ lag) / float(weights.sum())
    by_rate = np.exp(covariance.logs[1]) * (mean_lag - lag) * weights
    slope_p = np.zeros_like(p)
    by_strength = []
    for strength, order in zip(np.exp(covariance.logs[2:]), covariance.orders, strict=True):
        by_strength.append(float(np.sum(outer * (strength * p**order))))
        if order:
            slope_p += strength * order * p ** (order - 1)
    rate = float(np.sum(outer * slope_p * ((rows * by_rate) @ rows.T)))
    noise = float(np.trace(outer)) * covariance.noise_variance
    return value, np.array([noise, rate, *by_strength])


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialPosterior:
    """The training's lagged inputs, their weights in a prediction, and the factor behind them."""

    constant: float
    rows: Array
    covariance: _Covariance
    factor: Array
    dual: Array

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """The constant, the noise of a sample, and the decay per lag."""
        unknown = float("nan")
        return {
            "constant": Parameter(self.constant, unknown),
            "noise": Parameter(float(np.sqrt(self.covariance.noise_variance)), unknown),
            "decay_per_lag": Parameter(float(np.exp(self.covariance.logs[1])), unknown),
        }

    def predict(self, inputs: Array, history: Array | None = None) -> Array:
        """The posterior mean."""
        rows = lagged(inputs, history, self.rows.shape[1])
        mean: Array = self.constant + self.covariance.of(rows, self.rows) @ self.dual
        return mean

    def standard_deviation(self, inputs: Array, history: Array | None = None) -> Array:
        """Of the posterior, without the noise of a measurement."""
        rows = lagged(inputs, history, self.rows.shape[1])
        across = self.covariance.of(self.rows, rows)
        solved = linalg.solve_triangular(self.factor, across, lower=True, check_finite=False)
        own = self.covariance.sum_of_powers(np.sum(rows**2 * self.covariance.weights(), axis=1))
        return np.asarray(np.sqrt(np.maximum(own - np.sum(solved**2, axis=0), 0.0)))
