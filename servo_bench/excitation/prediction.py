"""What a schedule will do to a rig: its own model plays it, each period in `PIECES` pieces.

The peak current is the larger of what the model passes through and K_P times the largest step of
the command, which a velocity loop answers before anything has moved.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import gathered
from servo_bench.excitation.experiment import Schedule
from servo_bench.rig import RigConfig
from sim_rig.model import Simulated

PIECES = 8
SLOTS_AT_ONCE = 1 << 15
"""Of a long schedule, which is played to its end all the same: what its memory holds of it."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """What the model says; peaks are magnitudes. The load's velocity is the mean over a period, as
    a run reckons it from two samples of its angle."""

    motor_travel_rad: float
    load_travel_rad: float
    peak_velocity_rad_s: float
    load_velocity_rad_s: float
    peak_current_a: float
    rms_current_a: float


def predict(schedule: Schedule, rig: RigConfig) -> Prediction:
    """Play the schedule on the rig's model. ConfigError where the rig has no such model."""
    commands, piece_s = schedule.velocity_rad_s, np.float64(schedule.period_s / PIECES)
    parts = [commands[k : k + SLOTS_AT_ONCE] for k in range(0, commands.size, SLOTS_AT_ONCE)]
    with gathered():
        model = rig.model()
        at = model.at_rest()
        seen = _Extremes(at.recorded[0], at.recorded[3])
        for part in parts:
            simulated = model.simulate(np.repeat(part, PIECES), piece_s, at)
            seen, at = seen.with_more(simulated), simulated.end
    step_rad_s = float(np.abs(np.diff(commands, prepend=0.0)).max(initial=0.0))
    step_a = rig.nominal.proportional_gain_a_s_per_rad * step_rad_s
    return Prediction(
        motor_travel_rad=seen.motor_rad,
        load_travel_rad=seen.load_rad,
        peak_velocity_rad_s=seen.velocity_rad_s,
        load_velocity_rad_s=seen.load_step_rad / schedule.period_s,
        peak_current_a=max(seen.current_a, step_a),
        rms_current_a=float(np.sqrt(seen.squares_a2 / (PIECES * commands.size))),
    )


class _Extremes(NamedTuple):
    """Where both angles began, the largest that was seen, and the sum of the current's squares."""

    motor_from_rad: float
    load_from_rad: float
    motor_rad: float = 0.0
    load_rad: float = 0.0
    velocity_rad_s: float = 0.0
    load_step_rad: float = 0.0
    current_a: float = 0.0
    squares_a2: float = 0.0

    def with_more(self, seen: Simulated) -> "_Extremes":
        return self._replace(
            motor_rad=_larger(self.motor_rad, seen.motor_angle_rad - self.motor_from_rad),
            load_rad=_larger(self.load_rad, seen.load_angle_rad - self.load_from_rad),
            velocity_rad_s=_larger(self.velocity_rad_s, seen.motor_velocity_rad_s),
            load_step_rad=_larger(self.load_step_rad, np.diff(seen.load_angle_rad[::PIECES])),
            current_a=_larger(self.current_a, seen.motor_current_a),
            squares_a2=self.squares_a2 + float((seen.motor_current_a**2).sum()),
        )


def _larger(before: float, values: NDArray[np.float64]) -> float:
    return max(before, float(np.abs(values).max(initial=0.0)))
