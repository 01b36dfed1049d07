"""What estimators take and give: a training, a predictor, its parameters.

    estimator.fit(Training) -> Predictor        predictor.predict(inputs) -> response

Sample t of a response is the first that input t can reach (lag 0). `history` is what was played
before, newest last; before that the input was zero and the rig at rest.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import FitError
from servo_bench.excitation.msequence import m_sequence
from servo_bench.kernels.correlate import cross_correlation
from servo_bench.kernels.settled import refuse_integrator

Array = NDArray[np.float64]

LONGEST_MEMORY = 64
"""Lags from which on a linear kernel is taken to have died away."""

SETTLING = 512
"""Samples of history that a training on a periodic sequence brings along."""


@dataclass(frozen=True, slots=True, eq=False)
class Training:
    """What was played and what came back, shapes (n,), after a history of shape (h,).

    `polynomial` (octal) is set where `inputs` are whole periods of that binary M-sequence times
    `amplitude`, in the periodic steady state: some estimators need it, others are faster with it.
    FitError where the shapes differ or a number is missing.
    """

    inputs: Array
    response: Array
    history: Array
    polynomial: str | None = None
    amplitude: float = 1.0

    def __post_init__(self) -> None:
        if self.inputs.ndim != 1 or self.inputs.shape != self.response.shape:
            raise FitError(
                f"inputs have shape {self.inputs.shape} and the response {self.response.shape}: "
                f"both must be (n,), alike. Cut the longer one."
            )
        for name in ("inputs", "response", "history"):
            wrong = int(np.count_nonzero(~np.isfinite(getattr(self, name))))
            if wrong:
                raise FitError(
                    f"{wrong} of {getattr(self, name).size} samples of the {name} are not "
                    f"numbers. Bridge or cut them, or record again: a fit would spread them over "
                    f"every estimate."
                )
        for array in (self.inputs, self.response, self.history):
            array.setflags(write=False)

    def with_response(self, response: Array) -> "Training":
        """The same inputs with another response, for what a first model left over."""
        return Training(self.inputs, response, self.history, self.polynomial, self.amplitude)


def periodic_training(response_periods: Array, polynomial: str, amplitude: float) -> Training:
    """Whole periods of an M-sequence in steady state, shape (N,) or (periods, N), averaged.

    FitError where the response is no whole number of periods, not finite, or an angle.
    """
    chips = amplitude * m_sequence(polynomial)
    periods = np.atleast_2d(np.asarray(response_periods, np.float64))
    if periods.ndim != 2 or periods.shape[1] != chips.size:
        raise FitError(
            f"the response has shape {np.shape(response_periods)}: {polynomial} has periods of "
            f"{chips.size} samples. Cut the response to whole periods."
        )
    mean = periods.mean(axis=0)
    if np.isfinite(mean).all():  # else Training says what is wrong
        phi = cross_correlation(mean, polynomial)
        centred = phi - np.median(phi)
        later = np.arange(chips.size) >= LONGEST_MEMORY
        refuse_integrator(centred, later, float(np.abs(centred[~later]).max()))
    return Training(
        inputs=chips.astype(np.float64),
        response=mean,
        history=np.resize(chips[::-1], SETTLING)[::-1].astype(np.float64),
        polynomial=polynomial,
        amplitude=amplitude,
    )


@dataclass(frozen=True, slots=True)
class Parameter:
    """A number that was fitted, and its standard error (NaN where it is not known)."""

    value: float
    standard_error: float


class Predictor(Protocol):
    """A fitted model: what it predicts, how sure it is, and its numbers."""

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """The numbers that can be named; hyper-parameters have no standard error."""
        ...

    def predict(self, inputs: Array, history: Array | None = None) -> Array:
        """The response to `inputs`, shape (n,) -> (n,)."""
        ...

    def standard_deviation(self, inputs: Array, history: Array | None = None) -> Array:
        """Of each predicted sample, shape (n,) -> (n,), if the truth is in the model's class.

        What the class leaves out is not in it.
        """
        ...


class Estimator(Protocol):
    """Settings, and a fit that raises FitError where the training does not suffice."""

    def fit(self, training: Training) -> Predictor:
        """The model that the training supports best."""
        ...


def lagged(inputs: Array, history: Array | None, memory: int) -> Array:
    """u(t - i), shape (n, memory), contiguous; what the history does not reach is zero."""
    past = np.zeros(memory - 1)
    if history is not None and history.size and past.size:
        known = history[-past.size :]
        past[-known.size :] = known
    played = np.concatenate([past, np.asarray(inputs, np.float64)])
    windows = np.lib.stride_tricks.sliding_window_view(played, memory)
    return np.ascontiguousarray(windows[:, ::-1])


def played_from_rest(inputs: Array, history: Array | None) -> tuple[Array, int]:
    """Everything that a model with a state must play, and how much of it is history."""
    past = np.zeros(0) if history is None else np.asarray(history, np.float64)
    return np.concatenate([past, np.asarray(inputs, np.float64)]), past.size
