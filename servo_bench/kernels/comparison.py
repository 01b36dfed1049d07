"""A measured response beside what its kernels predict."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servo_bench.kernels.predict import predict, vaf_percent
from servo_bench.kernels.volterra import Kernels

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Measured, and predicted with kernels of order 1 and of orders 1 to 3; shapes (n,).

    `judged` marks the samples that the VAF is taken over: all that no hole in the run has spoilt.
    """

    measured: Array
    order1: Array
    order3: Array
    judged: NDArray[np.bool_]

    @property
    def vaf_order1_percent(self) -> float:
        """Variance that the linear kernel alone accounts for."""
        return vaf_percent(self.measured[self.judged], self.order1[self.judged])

    @property
    def vaf_order3_percent(self) -> float:
        """Variance that the kernels up to order 3 account for."""
        return vaf_percent(self.measured[self.judged], self.order3[self.judged])


def compare(
    kernels: Kernels,
    measured: Array,
    inputs: NDArray[np.floating],
    history: NDArray[np.floating],
    judged: NDArray[np.bool_] | None = None,
) -> Comparison:
    """Predict the response to `inputs` (u, shape (n,)), played after `history`.

    `judged` as in `Comparison`; all samples where it is not given.
    """
    return Comparison(
        measured=measured,
        order1=predict(kernels, inputs, 1, history=history),
        order3=predict(kernels, inputs, kernels.order, history=history),
        judged=np.ones(measured.size, np.bool_) if judged is None else judged,
    )
