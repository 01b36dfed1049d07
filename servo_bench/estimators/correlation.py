"""Plain correlation, the paper's method: one M-transform, every element read at its shift."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from servo_bench.errors import FitError
from servo_bench.estimators.data import Array, Parameter, Training, lagged
from servo_bench.estimators.elementary import elementary_sums
from servo_bench.kernels.predict import predict
from servo_bench.kernels.volterra import Kernels, extract


@dataclass(frozen=True, slots=True)
class Correlation:
    """`memory` at most the collision-free one of the polynomial; `order` 1 to 3."""

    memory: int = 18
    order: int = 3

    def fit(self, training: Training) -> "MeasuredKernels":
        """The kernels; FitError where the input is no M-sequence or the memory is too long."""
        if training.polynomial is None:
            raise FitError(
                "plain correlation needs whole periods of a binary M-sequence, and this training "
                "names none. Choose another estimator (regularised, play), or play an M-sequence."
            )
        kernels = extract(
            training.response, training.polynomial, training.amplitude, self.memory, self.order
        )
        return MeasuredKernels(kernels)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredKernels:
    """Kernels as a predictor."""

    kernels: Kernels

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """c0 and the linear coefficients, each with the scatter of the empty shifts."""
        scatter = self.kernels.scatter
        values = {"constant": self.kernels.constant}
        values |= {f"c1_{lag}": float(c) for lag, c in enumerate(self.kernels.c1)}
        return {name: Parameter(value, scatter) for name, value in values.items()}

    def predict(self, inputs: Array, history: Array | None = None) -> Array:
        """Exact in form for input of +-amplitude only."""
        amplitude = self.kernels.amplitude
        past = None if history is None else history / amplitude
        return predict(self.kernels, inputs / amplitude, self.kernels.order, history=past)

    def standard_deviation(self, inputs: Array, history: Array | None = None) -> Array:
        """The scatter of the coefficients, carried through the sums."""
        memory, orders = self.kernels.memory, np.arange(1, self.kernels.order + 1)
        squares = (lagged(inputs, history, memory) / self.kernels.amplitude) ** 2
        terms = 1.0 + elementary_sums(squares, np.ones((orders.size, memory)), orders)
        deviation: Array = self.kernels.scatter * np.sqrt(terms)
        return deviation
