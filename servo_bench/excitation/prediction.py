"""What a schedule will do to a rig: its own model plays it, each period in `PIECES` pieces.

The peak current is the larger of what the model passes through and K_P times the largest step of
the command, which a velocity loop answers before anything has moved.
"""

from dataclasses import dataclass

import numpy as np

from servo_bench.errors import gathered
from servo_bench.excitation.experiment import Schedule
from servo_bench.rig import RigConfig

PIECES = 8
MOST_SLOTS = 1 << 15
"""A stationary excitation says all it has to say in so many slots."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """What the model says; peaks are magnitudes."""

    motor_travel_rad: float
    load_travel_rad: float
    peak_velocity_rad_s: float
    peak_current_a: float
    rms_current_a: float


def predict(schedule: Schedule, rig: RigConfig) -> Prediction:
    """Play the schedule on the rig's model. ConfigError where the rig has no such model."""
    commands = schedule.velocity_rad_s[:MOST_SLOTS]
    with gathered():
        simulated = rig.model().simulate(
            np.repeat(commands, PIECES), np.float64(schedule.period_s / PIECES)
        )
    step_rad_s = float(np.abs(np.diff(commands, prepend=0.0)).max(initial=0.0))
    step_a = rig.nominal.proportional_gain_a_s_per_rad * step_rad_s
    current_a = simulated.motor_current_a
    return Prediction(
        motor_travel_rad=_reach(simulated.motor_angle_rad),
        load_travel_rad=_reach(simulated.load_angle_rad),
        peak_velocity_rad_s=float(np.abs(simulated.motor_velocity_rad_s).max()),
        peak_current_a=max(float(np.abs(current_a).max()), step_a),
        rms_current_a=float(np.sqrt(np.mean(current_a**2))),
    )


def _reach(angle_rad: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    return float(np.abs(angle_rad - angle_rad[0]).max())
