"""The nominal plant behind a recording from elsewhere: what its makers say of it, all optional.

A rig of the bench has a `RigConfig`; a motor on someone else's table has at most the values below.
What nobody published is absent, and is never guessed.
"""

from typing import Any

from pydantic import PositiveFloat

from servo_bench.files import Value, validated


class Pendulum(Value):
    """A point mass on an arm that hangs down at angle zero: tau = -m g l sin(angle)."""

    mass_kg: PositiveFloat
    length_m: PositiveFloat
    """From the axis to the centre of mass."""


class PositionLoop(Value):
    """A proportional position loop in the drive: u = gain (command - position), |u| <= limit."""

    proportional_gain_v_per_rad: PositiveFloat
    voltage_limit_v: PositiveFloat | None = None


class ForeignPlant(Value):
    """`[plant]` of a map. Angles, torques and inertia are at the axis on which the motor's angle is
    given; the torque constant is the motor's own.

    inertia_kg_m2             of all that turns with the motor, without the pendulum
    torque_constant_nm_per_a  K_T
    resistance_ohm            of the winding, where the voltage is the input
    gear_ratio                motor turns per turn of the axis on which the angle is given
    backlash_gap_rad          play between motor and load
    output_locked             the load cannot turn: the motor's angle is the transmission's twist
    """

    name: str
    inertia_kg_m2: PositiveFloat | None = None
    torque_constant_nm_per_a: PositiveFloat | None = None
    resistance_ohm: PositiveFloat | None = None
    gear_ratio: PositiveFloat = 1.0
    backlash_gap_rad: PositiveFloat | None = None
    output_locked: bool = False
    pendulum: Pendulum | None = None
    position_loop: PositionLoop | None = None

    @property
    def axis_nm_per_a(self) -> float | None:
        """What an ampere makes at the axis: K_T times the gear's ratio; None where nobody says."""
        constant = self.torque_constant_nm_per_a
        return None if constant is None else constant * self.gear_ratio


def plant_from_table(table: dict[str, Any], source: str) -> ForeignPlant:
    """A plant from a map or from a recording; ConfigError where it does not fit."""
    return validated(ForeignPlant, table, source)
