"""Where a simulation starts and stops, and what it returns."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COLUMNS, CLOCK = 8, 6


class ModelState(NamedTuple):
    """The whole rig at one instant: `values` as the page keeps them, `recorded` as its row."""

    values: tuple[float, ...]
    recorded: tuple[float, ...]

    @property
    def time_s(self) -> float:
        """Since the simulation's beginning, on the rig's clock."""
        return self.values[CLOCK]


class Simulated(NamedTuple):
    """The rig at every ask, before that slot's command acts: arrays of shape (slots,), SI.

    The first four are what is recorded, sensors' errors included; the others are the truth.
    """

    motor_angle_rad: Array
    motor_velocity_rad_s: Array
    motor_current_a: Array
    load_angle_rad: Array
    true_load_angle_rad: Array
    load_velocity_rad_s: Array
    contact_torque_nm: Array
    integral_rad: Array
    end: ModelState


def simulated(start: ModelState, rows: Array, values: Array) -> Simulated:
    """Rows at the slots' ends, shape (slots, COLUMNS), as the asks at their beginnings."""
    asked = np.vstack((np.array(start.recorded), rows))
    end = ModelState(tuple(values.tolist()), tuple(asked[-1].tolist()))
    angle, velocity, current, load, true_load, rate, torque, integral = asked[:-1].T.copy()
    return Simulated(angle, velocity, current, load, true_load, rate, torque, integral, end)
