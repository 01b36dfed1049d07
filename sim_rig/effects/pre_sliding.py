"""Pre-sliding friction (Dahl): a bristle that bends before the motor's shaft slides.

    tau = -T z,      b dz/dt = omega - |omega| z,      b = T / sigma

T  torque_nm              sliding torque, reached after a few b
b  breakaway_angle_rad    T over the stiffness sigma of the contact at rest
z  bend_fraction          the bend over b, -1 to 1

Holds at standstill: a spring for micro-moves, Coulomb friction (with T) for large ones.
z is advanced exactly at the velocity in the middle of the step.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Known, LogUniform, Port, Value


class Params(NamedTuple):
    """Zero torque switches it off."""

    torque_nm: Annotated[float, LogUniform(1e-4, 0.1)] = 0.0
    breakaway_angle_rad: Annotated[float, Known(1e-5, 1e-3)] = 3e-4


class Memory(NamedTuple):
    """The bristle's bend over the break-away angle: -1 to 1."""

    bend_fraction: Value = 0.0


def law(s: Any, z: Memory, p: Params) -> Any:
    """Torque on the motor, Nm, at the middle of the step."""
    travel = s.motor_velocity_rad_s * 0.5 * s.step_s / p.breakaway_angle_rad
    side = np.sign(travel)
    return -p.torque_nm * (side + (z.bend_fraction - side) * np.exp(-np.abs(travel)))


def advance(s: Any, z: Memory, p: Params, dt_s: float) -> Memory:
    """The bend at the end of the step."""
    travel = s.motor_velocity_rad_s * dt_s / p.breakaway_angle_rad
    side = np.sign(travel)
    return Memory(side + (z.bend_fraction - side) * np.exp(-np.abs(travel)))


EFFECT = Effect(
    port=Port.MOTOR_TORQUE,
    params=Params,
    law=law,
    memory=Memory,
    advance=advance,
    sample={"torque_nm": 0.01},
    shows="hysteresis of angle against current for micro-moves; stiffness falls with amplitude",
    confused_with=("coupling_compliance", "coulomb", "stribeck", "thermal_friction"),
    source="Dahl, Aerospace Corp. TOR-158 (1968); Canudas de Wit et al., IEEE TAC 40 (1995)",
)
