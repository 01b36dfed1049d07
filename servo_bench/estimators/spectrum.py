"""The M-sequence as an orthogonal basis: all N shifts and the constant, on N + 1 inputs.

The registers of one period are all words but zero. With the input that the word zero would make
(all chips +1) as an extra place, the products of chips are the Walsh functions of the words, one
for each shift and one constant, orthogonal and complete. A multilinear system's output there is a
sum over shifts, and two elements are either the same function or orthogonal.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servo_bench.excitation.msequence import m_sequence
from servo_bench.kernels.correlate import cross_correlation
from servo_bench.kernels.own_response import sequence_response

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Transforms between places (N + 1, the last is the word zero) and shifts (N)."""

    polynomial: str

    def lags(self, memory: int) -> Array:
        """The chips that each place sees, shape (N + 1, memory), each +1 or -1."""
        chips = m_sequence(self.polynomial).astype(np.float64)
        rows = [np.append(np.roll(chips, lag), 1.0) for lag in range(memory)]
        return np.ascontiguousarray(np.stack(rows, axis=1))

    def shifts_of(self, places: Array) -> Array:
        """The coefficient of every shift, (..., N + 1) -> (..., N); the constant is dropped."""
        chips = places.shape[-1] - 1
        phi = cross_correlation(places[..., :-1], self.polynomial)
        coefficients: Array = (chips * phi + places[..., -1:]) / (chips + 1)
        return coefficients

    def places_of(self, shifts: Array) -> Array:
        """The transpose of `shifts_of`: (N,) -> (N + 1,)."""
        sums = sequence_response(shifts, self.polynomial)
        return np.append(sums, shifts.sum()) / (shifts.size + 1)
