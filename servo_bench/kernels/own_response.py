"""The periodic response to an M-sequence of a system that is given shift by shift."""

import numpy as np
from numpy.typing import NDArray

from servo_bench.kernels.transform import m_synthesis

Array = NDArray[np.float64]


def sequence_response(coefficients: Array, polynomial: str) -> Array:
    """y(t) = sum_k coefficients(k) u(t - k), shape (N,) -> (N,).

    On its own M-sequence every kernel of any order is such a sum, for a product of chips is the
    sequence at another shift: all orders are one circular convolution.
    """
    return m_synthesis(coefficients, polynomial)
