"""A plant as a rig's devices sit on it: behind a gear, and counting one way or the other.

    motor's encoder, current   = direction * gear ratio * angle, direction * current
    load's encoder             = load's direction * angle

The plant's motor angle is that of the shaft which the bench calls so; the encoder of a geared
motor turns `gear_ratio` times as far. A drive tells its torque as the bench reads it, at that
shaft.
"""

from dataclasses import replace

from sim_rig.plant import Plant, PlantOutputs
from sim_rig.settings import RigSettings


class Mounted:
    """Stands behind the `Plant` protocol, as the plant that it turns."""

    def __init__(self, plant: Plant, settings: RigSettings) -> None:
        self._plant = plant
        self._motor, self._load = settings.motor_direction, settings.load_direction
        self._turns = settings.motor_direction * settings.gear_ratio

    def advance(self, velocity_command_rad_s: float | None, duration_s: float) -> None:
        """Hold the command of the motor itself for `duration_s`; None: the power stage is off."""
        command = velocity_command_rad_s
        self._plant.advance(None if command is None else command / self._turns, duration_s)

    def outputs(self) -> PlantOutputs:
        """What the devices' own sensors see."""
        shaft = self._plant.outputs()
        return replace(
            shaft,
            motor_position_rad=self._turns * shaft.motor_position_rad,
            motor_velocity_rad_s=self._turns * shaft.motor_velocity_rad_s,
            motor_current_a=self._motor * shaft.motor_current_a,
            load_angle_rad=self._load * shaft.load_angle_rad,
        )


def mounted(plant: Plant, settings: RigSettings) -> Plant:
    """The plant itself where nothing is geared or turned around."""
    as_it_is = (settings.motor_direction, settings.load_direction, settings.gear_ratio)
    return plant if as_it_is == (1, 1, 1.0) else Mounted(plant, settings)
