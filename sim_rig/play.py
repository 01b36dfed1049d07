"""The play (backlash) between motor and load: a rigid gap, a load that stays where it is left.

    y <- min(max(y, theta - W/2), theta + W/2)

theta motor angle, y load angle, W full width of the gap (the paper's W = |2a|, slope 1). It does
not know time: only where the motor turned around matters.
"""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray


def play(load_angle_rad: float, motor_angle_rad: float, gap_rad: float) -> float:
    """The load's angle after the motor has moved, without a turn on its way, to its angle."""
    half = 0.5 * gap_rad
    return min(max(load_angle_rad, motor_angle_rad - half), motor_angle_rad + half)


class Limits(NamedTuple):
    """What a whole movement does to any load: y -> min(max(y, low), high).

    Plays in a row make one such clamp again, so a movement is reduced without knowing where the
    load was. Arrays of shape (slots,).
    """

    low_rad: NDArray[np.float64]
    high_rad: NDArray[np.float64]

    @classmethod
    def around(cls, motor_angle_rad: NDArray[np.float64], gap_rad: float) -> Self:
        """One play at a motor angle."""
        half = 0.5 * gap_rad
        return cls(motor_angle_rad - half, motor_angle_rad + half)

    def then(self, after: "Limits") -> "Limits":
        """This movement, then another."""
        return Limits(
            np.minimum(np.maximum(self.low_rad, after.low_rad), after.high_rad),
            np.minimum(np.maximum(self.high_rad, after.low_rad), after.high_rad),
        )
