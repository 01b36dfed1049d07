"""The periodic response to an M-sequence of a system that is given shift by shift."""

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from servo_bench.excitation.msequence import m_sequence

Array = NDArray[np.float64]


def sequence_response(coefficients: Array, polynomial: str) -> Array:
    """y(t) = sum_k coefficients(k) u(t - k), shape (N,) -> (N,).

    On its own M-sequence every kernel of any order is such a sum, for a product of chips is the
    sequence at another shift: all orders are one circular convolution.
    """
    chips = m_sequence(polynomial).astype(np.float64)
    spectrum = fft.rfft(chips) * fft.rfft(coefficients)
    return np.asarray(fft.irfft(spectrum, chips.size))
