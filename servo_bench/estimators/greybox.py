"""Grey box: a rig model with a handful of numbers, fitted by nonlinear least squares.

Any model that says where to start and plays inputs from rest can be fitted (`RigModel`). Built in
is the paper's, a second-order loop and a play, with what real loads add:

    x = (2 zeta wn z s + wn^2) / (s^2 + 2 zeta wn s + wn^2) u,      u held over a period
    y = K / (1 + s tau) P[x]         or, with `integrates`,  increments of K / (1 + s tau) P[x / s]

P is a rigid gap of half width half_gap / K in which the load coasts: pushed, it moves as x does;
let go, its velocity decays with coast_s. Zero is the play that stays where it is left. half_gap
is in units of y, z is `zero_gain`, tau `lag_s`.

All substeps of a period are inside one compiled loop, for the play has memory and a branch, so it
has no array form (numba; 0.5 ms for 4095 samples).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numba
import numpy as np
from scipy.linalg import expm
from scipy.optimize import OptimizeResult, least_squares

from servo_bench.errors import FitError
from servo_bench.estimators.data import Array, Parameter, Training, played_from_rest

SUBSTEPS = 20
DIFFERENCE_STEPS = (1e-2, 1e-4)
"""Of the finite differences, coarse first: a rigid play makes the error ripple."""
SCOUTED = 8
"""Steps from every start, before the best two go on to their end."""


class RigModel(Protocol):
    """A model with named numbers. Lengths of `scales` and of each start: one per name."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the numbers, with their units."""
        ...

    @property
    def starts(self) -> Array:
        """Where fits begin, shape (starts, numbers); the best two of them are ended."""
        ...

    @property
    def scales(self) -> Array:
        """A change of each number that matters, shape (numbers,)."""
        ...

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest value of each number."""
        ...

    def play(self, numbers: Array, inputs: Array) -> Array:
        """The response from rest, (n,) -> (n,); sample t is the first that input t can reach."""
        ...


@dataclass(frozen=True, slots=True)
class SecondOrderPlay:
    """The paper's rig at a period. `integrates`: the play acts on the angle (the experiment).

    `natural_frequency_rad_s` and `half_gap` are rough guesses to start from.
    """

    period_s: float = 0.5
    natural_frequency_rad_s: float = 1.0
    half_gap: float = 0.4
    integrates: bool = False

    names: tuple[str, ...] = (
        "natural_frequency_rad_s",
        "damping_ratio",
        "zero_gain",
        "half_gap",
        "gain",
        "lag_s",
        "coast_s",
    )

    @property
    def starts(self) -> Array:
        """Two frequencies by two gaps."""
        wn, gap = self.natural_frequency_rad_s, self.half_gap
        return np.array(
            [
                [f * wn, 0.5, 0.7, g * gap, 1.0, 0.2 * self.period_s, 0.2 * self.period_s]
                for f in (0.7, 1.1)
                for g in (0.5, 1.2)
            ]
        )

    @property
    def scales(self) -> Array:
        """A third of each."""
        wn, gap = self.natural_frequency_rad_s, self.half_gap
        return np.array(
            [0.3 * wn, 0.2, 0.3, 0.5 * gap, 0.3, 0.2 * self.period_s, 0.2 * self.period_s]
        )

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Positive, and slow enough for the period."""
        wn, gap, period = self.natural_frequency_rad_s, self.half_gap, self.period_s
        low = np.array([0.05 * wn, 0.02, -5.0, 0.0, 0.0, 0.0, 0.0])
        return low, np.array([10.0 * wn, 5.0, 5.0, 20.0 * gap, 20.0, 20.0 * period, 20.0 * period])

    def play(self, numbers: Array, inputs: Array) -> Array:
        """The response from rest."""
        wn, zeta, zero, half_gap, gain, lag_s, coast_s = numbers
        rates = np.zeros((4, 4))  # z1, z2, angle, input
        row = np.array([wn**2, 2.0 * zeta * wn * zero, 0.0, 0.0])
        rates[0, 1] = 1.0
        rates[1] = [-(wn**2), -2.0 * zeta * wn, 0.0, 1.0]
        rates[2] = row
        step_s = self.period_s / SUBSTEPS
        step = expm(rates * step_s)[:3]
        seen = np.array([0.0, 0.0, 1.0]) if self.integrates else row[:3]
        memories = np.array([_kept(step_s, lag_s), _kept(step_s, coast_s)])
        held = np.ascontiguousarray(inputs, np.float64)
        outputs = gain * np.asarray(_played(held, step, seen, half_gap / max(gain, 1e-9), memories))
        if self.integrates:
            return np.asarray(np.diff(outputs)) / self.period_s
        return np.asarray(outputs[:-1])


def _kept(step_s: float, time_s: float) -> float:
    """The share that a first-order memory of `time_s` keeps over a step."""
    return float(np.exp(-step_s / time_s)) if time_s > 0.0 else 0.0


@numba.njit(cache=True)
def _played(inputs: Array, step: Array, seen: Array, half_gap: float, memories: Array) -> Array:
    """The output before each input and after the last, shape (n + 1,)."""
    outputs = np.zeros(inputs.size + 1)
    a, b, angle, play, output = 0.0, 0.0, 0.0, 0.0, 0.0
    before, stride = 0.0, 0.0
    for t in range(inputs.size):
        u = inputs[t]
        for _ in range(SUBSTEPS):
            angle += step[2, 0] * a + step[2, 1] * b + step[2, 3] * u
            moved = step[0, 0] * a + step[0, 1] * b + step[0, 3] * u
            b = step[1, 0] * a + step[1, 1] * b + step[1, 3] * u
            a = moved
            x = seen[0] * a + seen[1] * b + seen[2] * angle
            stride *= memories[1]
            coasted = play + stride
            play = min(max(coasted, x - half_gap), x + half_gap)
            if play != coasted:
                stride = x - before
            before = x
            output = play + memories[0] * (output - play)
        outputs[t + 1] = output
    return outputs


@dataclass(frozen=True, slots=True)
class GreyBox:
    """Fits a rig model."""

    model: RigModel = SecondOrderPlay()

    def fit(self, training: Training) -> "GreyBoxModel":
        """The better of the two most promising starts; FitError where none leads anywhere."""
        whole, past = played_from_rest(training.inputs, training.history)
        low, high = self.model.bounds

        def error(numbers: Array) -> Array:
            left: Array = self.model.play(numbers, whole)[past:] - training.response
            return np.asarray(left - left.mean())

        def searched(numbers: Array, step: float, steps: int | None = None) -> OptimizeResult:
            return least_squares(
                error,
                numbers,
                bounds=(low, high),
                x_scale=self.model.scales,
                diff_step=np.full(numbers.size, step),
                max_nfev=steps,
            )

        coarse, fine = DIFFERENCE_STEPS
        scouts = [
            searched(np.clip(start, low, high), coarse, SCOUTED) for start in self.model.starts
        ]
        scouts = sorted((s for s in scouts if np.isfinite(s.cost)), key=lambda s: float(s.cost))
        ended = [searched(searched(scout.x, coarse).x, fine) for scout in scouts[:2]]
        best = min(ended, key=lambda end: float(end.cost), default=None)
        if best is None:
            raise FitError(
                "the rig model gave no finite output from any of its starts: its numbers do not "
                "fit this training's units. Give it a natural frequency and a gap near the rig's."
            )
        constant = float(np.mean(training.response - self.model.play(best.x, whole)[past:]))
        jacobian = np.asarray(best.jac, np.float64)
        variance = 2.0 * best.cost / max(training.inputs.size - best.x.size, 1)
        information = jacobian.T @ jacobian
        covariance = variance * np.asarray(np.linalg.pinv(information, hermitian=True), np.float64)
        return GreyBoxModel(self.model, best.x, constant, covariance)


@dataclass(frozen=True, slots=True, eq=False)
class GreyBoxModel:
    """A rig model with its numbers, a constant, and the numbers' covariance."""

    model: RigModel
    numbers: Array
    constant: float
    covariance: Array

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """By the model's names."""
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return {
            name: Parameter(float(value), float(error))
            for name, value, error in zip(self.model.names, self.numbers, errors, strict=True)
        }

    def predict(self, inputs: Array, history: Array | None = None) -> Array:
        """From rest through the history."""
        whole, past = played_from_rest(inputs, history)
        return self.constant + self.model.play(self.numbers, whole)[past:]

    def standard_deviation(self, inputs: Array, history: Array | None = None) -> Array:
        """By finite differences along the covariance's principal axes."""
        values, axes = np.linalg.eigh(self.covariance)
        here = self.predict(inputs, history)
        whole, past = played_from_rest(inputs, history)
        variance = np.zeros_like(here)
        for value, axis in zip(values, axes.T, strict=True):
            moved = self.numbers + axis * np.sqrt(max(value, 0.0))
            change = self.constant + self.model.play(moved, whole)[past:] - here
            variance += change**2
        return np.sqrt(variance)
