"""The seam between the wire and the physics: anything with these two methods can be the rig.

The rig's own model and every independent plant of the tests stand behind it alike. The slaves on
the wire know nothing else of mechanics.
"""

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class PlantOutputs:
    """The rig at one instant, SI, as ideal sensors would see it."""

    motor_position_rad: float
    motor_velocity_rad_s: float
    motor_current_a: float
    load_angle_rad: float


class Plant(Protocol):
    """A servo axis from velocity command to load angle, stepped by whoever owns the clock."""

    def advance(self, velocity_command_rad_s: float | None, duration_s: float) -> None:
        """Hold the command for `duration_s`; None means the power stage is off and it coasts."""
        ...

    def outputs(self) -> PlantOutputs:
        """The present state; changes nothing."""
        ...
