"""A measured response beside what its kernels predict."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servo_bench.kernels.predict import predict, vaf_percent
from servo_bench.kernels.volterra import Kernels

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Measured, and predicted with kernels of order 1 and of orders 1 to 3; shapes (n,)."""

    measured: Array
    order1: Array
    order3: Array

    @property
    def vaf_order1_percent(self) -> float:
        """Variance that the linear kernel alone accounts for."""
        return vaf_percent(self.measured, self.order1)

    @property
    def vaf_order3_percent(self) -> float:
        """Variance that the kernels up to order 3 account for."""
        return vaf_percent(self.measured, self.order3)


def compare(
    kernels: Kernels, measured: Array, inputs: NDArray[np.floating], history: NDArray[np.floating]
) -> Comparison:
    """Predict the response to `inputs` (u, shape (n,)), played after `history`."""
    return Comparison(
        measured=measured,
        order1=predict(kernels, inputs, 1, history=history),
        order3=predict(kernels, inputs, kernels.order, history=history),
    )
