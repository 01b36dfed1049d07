"""The sequence that a rig was identified with, and how kernels are read from its periods.

    m-sequence       correlation, every element at its shift
    inverse-repeat   the same, for odd and even orders apart
    field            three or five levels: least squares

Several amplitudes are several plays of an m-sequence, see `identification.locate_amplitudes`.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from servo_bench.excitation.fields import field_sequence
from servo_bench.excitation.msequence import m_sequence
from servo_bench.excitation.sequences import inverse_repeat
from servo_bench.kernels.labels import ElementLabels, element_labels, level_labels
from servo_bench.kernels.levels import extract_levels, level_memory
from servo_bench.kernels.separation import extract_inverse_repeat
from servo_bench.kernels.shifts import collision_free_memory
from servo_bench.kernels.volterra import Kernels, check_memory, extract

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Played:
    """A periodic sequence. `polynomial` is octal, or for a `field` of 3 or 5 its coefficients."""

    polynomial: str
    kind: Literal["m-sequence", "inverse-repeat", "field"] = "m-sequence"
    field: int = 2

    @property
    def chips(self) -> Array:
        """One period within +-1, shape (N,). ConfigError where the polynomial is not primitive."""
        match self.kind:
            case "inverse-repeat":
                return inverse_repeat(self.polynomial).astype(np.float64)
            case "field":
                return field_sequence(self.field, self.polynomial)
            case _:
                return m_sequence(self.polynomial).astype(np.float64)

    @property
    def resolvable_memory(self) -> int:
        """The longest memory in which every element up to order 3 stays apart."""
        if self.kind == "field":
            return level_memory(self.field, self.polynomial)
        mirrored = self.kind == "inverse-repeat"
        return collision_free_memory(self.polynomial, 3, inverse_repeat=mirrored)

    def kernels(self, periods: Array, amplitude: float, memory: int, *, period_s: float) -> Kernels:
        """Kernels to order 3 of whole periods, shape (periods, N). FitError as the extraction's."""
        match self.kind:
            case "inverse-repeat":
                return extract_inverse_repeat(
                    periods, self.polynomial, amplitude, memory, period_s=period_s
                )
            case "field":
                return extract_levels(
                    periods, self.chips, self.polynomial, amplitude, memory, period_s=period_s
                )
            case _:
                return extract(periods, self.polynomial, amplitude, memory, period_s=period_s)

    def labels(self, memory: int, amplitudes: int = 1) -> ElementLabels:
        """What it can say about each element."""
        if self.kind == "field":
            return level_labels(self.field, memory)
        mirrored = self.kind == "inverse-repeat"
        return element_labels(
            self.polynomial, memory, amplitudes=amplitudes, inverse_repeat=mirrored
        )


def as_played(sequence: "Played | str") -> Played:
    """A polynomial alone, in octal, is a plain M-sequence."""
    return Played(sequence) if isinstance(sequence, str) else sequence


def need_resolvable(played: Played, memory: int) -> None:
    """Raise FitError for a memory in which a binary sequence cannot tell elements apart; a field's
    extraction says it itself."""
    if played.kind != "field":
        mirrored = played.kind == "inverse-repeat"
        check_memory(played.polynomial, memory, inverse_repeat=mirrored)
