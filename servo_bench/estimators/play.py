"""A linear filter followed by play operators (Prandtl-Ishlinskii), by Gauss-Newton.

    x = sum_i h_i u(t-i)      P_r: y = min(max(y, x - r), x + r), from zero
    y = c + sum_j w_j P_(r_j)[x],      one play: w = 1 (L P_r[x] = P_(L r)[L x])

A play's output is x -+ r of the last sample that pushed it, so its derivatives by h and r are the
lags and the side of that sample: exact, and as cheap as the output. Only the push recursion is a
loop over samples, with a branch on its own past; hence numba.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import FitError
from servo_bench.estimators.data import Array, Parameter, Training, lagged, played_from_rest

ITERATIONS = 60
START_RADII = (0.15, 0.4, 0.8)
"""Of one play, in standard deviations of the filter's output: the best of these starts wins."""

CONVERGED = 1e-10


@dataclass(frozen=True, slots=True)
class FirPlay:
    """`memory` of the filter in samples, and how many plays there are."""

    memory: int = 30
    plays: int = 1

    def fit(self, training: Training) -> "FirPlayFit":
        """FitError where there are fewer samples than unknowns."""
        unknowns = self.memory + 2 * self.plays + 1
        if training.inputs.size <= unknowns:
            raise FitError(
                f"{training.inputs.size} samples cannot fix {unknowns} unknowns of filter and "
                f"plays. Give more samples or a shorter memory."
            )
        whole, past = played_from_rest(training.inputs, training.history)
        rows = lagged(whole, None, self.memory)
        response = training.response
        linear = np.linalg.lstsq(rows[past:], response - response.mean(), rcond=None)[0]
        level = float(np.std(rows @ linear))
        fits = [
            _gauss_newton(
                _Model(self.memory, *_start(self.plays, linear, level, radius)),
                rows,
                response,
                past,
            )
            for radius in START_RADII
        ]
        return min(fits, key=lambda fit: fit.noise_variance)


def _start(plays: int, linear: Array, level: float, radius: float) -> tuple[Array, Array, Array]:
    """A filter, radii, and weights near the linear fit; plays spread from none to twice radius."""
    if plays == 1:
        return linear * (1.0 + 0.5 * radius), np.array([radius * level]), np.ones(1)
    radii = level * 2.0 * radius * np.arange(plays) / (plays - 1)
    return linear * (1.0 + 0.5 * radius), radii, np.full(plays, 1.0 / plays)


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
    """Filter, radii and weights of the plays, and the constant."""

    memory: int
    filter: Array
    radii: Array
    weights: Array
    constant: float = 0.0

    @property
    def fixed_weight(self) -> bool:
        return self.radii.size == 1

    def vector(self) -> Array:
        weights = self.weights[: 0 if self.fixed_weight else None]
        return np.concatenate([self.filter, self.radii, weights, [self.constant]])

    def moved_to(self, vector: Array) -> "_Model":
        after = self.memory + self.radii.size
        weights = self.weights if self.fixed_weight else vector[after:-1]
        radii = np.abs(vector[self.memory : after])
        return _Model(self.memory, vector[: self.memory], radii, weights, float(vector[-1]))

    def evaluated(self, rows: Array, past: int) -> tuple[Array, Array]:
        """Output after `past` samples, and its derivatives by `vector`, (n,) and (n, unknowns)."""
        x = rows @ self.filter
        by_filter = np.zeros((len(rows) - past, self.memory))
        by_radius, outputs = [], []
        for radius, weight in zip(self.radii, self.weights, strict=True):
            pushed, side = _last_push(x, radius)
            pushed, side = pushed[past:], side[past:]
            outputs.append(np.where(side == 0, 0.0, x[pushed] - side * radius))
            by_filter += weight * np.abs(side)[:, None] * rows[pushed]
            by_radius.append(-weight * side)
        plays = np.stack(outputs, axis=1)
        by_weight = plays[:, : 0 if self.fixed_weight else None]
        one = np.ones((len(plays), 1))
        jacobian = np.hstack([by_filter, np.stack(by_radius, axis=1), by_weight, one])
        return self.constant + plays @ self.weights, jacobian


def _gauss_newton(model: _Model, rows: Array, response: Array, past: int) -> "FirPlayFit":
    """Levenberg's damping, which also holds the scale that filter and weights share."""
    output, jacobian = model.evaluated(rows, past)
    error, damping = response - output, 1e-3
    for _ in range(ITERATIONS):
        information = jacobian.T @ jacobian
        ridge = damping * (np.diag(information) + 1e-9 * np.trace(information))
        step = np.linalg.solve(information + np.diag(ridge), jacobian.T @ error)
        tried = model.moved_to(model.vector() + step)
        output, tried_jacobian = tried.evaluated(rows, past)
        gain = float(error @ error) - float(np.sum((response - output) ** 2))
        if gain <= 0.0:
            damping *= 8.0
            if damping > 1e8:
                break
            continue
        small = gain < CONVERGED * float(error @ error)
        model, jacobian, error, damping = tried, tried_jacobian, response - output, damping / 5.0
        if small:
            break
    variance = float(error @ error) / max(error.size - model.vector().size, 1)
    covariance = variance * np.asarray(
        np.linalg.pinv(jacobian.T @ jacobian, hermitian=True), np.float64
    )
    return FirPlayFit(model, covariance, variance)


@dataclass(frozen=True, slots=True, eq=False)
class FirPlayFit:
    """The fitted operator, the covariance of its unknowns, and the variance it left over."""

    model: _Model
    covariance: Array
    noise_variance: float

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Radii (half widths, in the response's unit), weights, filter taps, constant."""
        model = self.model
        names = [f"tap_{lag}" for lag in range(model.memory)]
        names += [f"radius_{play}" for play in range(model.radii.size)]
        names += [f"weight_{play}" for play in range(0 if model.fixed_weight else model.radii.size)]
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return {
            name: Parameter(float(value), float(error))
            for name, value, error in zip([*names, "constant"], model.vector(), errors, strict=True)
        }

    def predict(self, inputs: Array, history: Array | None = None) -> Array:
        """From rest through the history, so that the plays stand where they should."""
        return self._evaluated(inputs, history)[0]

    def standard_deviation(self, inputs: Array, history: Array | None = None) -> Array:
        """By the derivatives of the output and the covariance of the unknowns."""
        jacobian = self._evaluated(inputs, history)[1]
        variance = np.einsum("ti,ti->t", jacobian @ self.covariance, jacobian)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def _evaluated(self, inputs: Array, history: Array | None) -> tuple[Array, Array]:
        whole, past = played_from_rest(inputs, history)
        return self.model.evaluated(lagged(whole, None, self.model.memory), past)


@numba.njit(cache=True)
def _last_push(x: Array, radius: float) -> tuple[NDArray[np.int64], Array]:
    """The sample that last pushed the play, and from which side (+1 up, -1 down, 0 none yet)."""
    pushed = np.zeros(x.size, np.int64)
    side = np.zeros(x.size)
    y, last, from_side = 0.0, 0, 0.0
    for t in range(x.size):
        if x[t] - radius > y:
            y, last, from_side = x[t] - radius, t, 1.0
        elif x[t] + radius < y:
            y, last, from_side = x[t] + radius, t, -1.0
        pushed[t], side[t] = last, from_side
    return pushed, side
