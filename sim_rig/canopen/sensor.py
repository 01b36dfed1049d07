"""An angle in counts, as an incremental or absolute encoder has it.

    counts = floor(angle / (2 pi) * N + n + 1/2),    n white, normal, per sample

so that the angle zero lies in the middle of count zero.
"""

import math
from collections.abc import Callable

import numpy as np


class AngleEncoder:
    """N counts in a revolution, noise in rad, and the generator that the noise is drawn from.

    `distortion` is what a fault makes of the counts.
    """

    def __init__(
        self, counts_per_revolution: int, noise_rad: float, random: np.random.Generator
    ) -> None:
        self._counts_per_rad = counts_per_revolution / math.tau
        self._noise_rad = noise_rad
        self._random = random
        self.distortion: Callable[[int], int] | None = None

    def counts(self, angle_rad: float) -> int:
        """One sample of an angle, running on over revolutions."""
        if self._noise_rad:
            angle_rad += self._noise_rad * float(self._random.standard_normal())
        counts = math.floor(angle_rad * self._counts_per_rad + 0.5)
        return counts if self.distortion is None else self.distortion(counts)
