"""Stribeck friction: what friction at slow motion exceeds sliding friction by, at the motor.

    tau = -T exp(-(|omega| / omega_s)^n) tanh(omega / omega_0)

T        excess_torque_nm     break-away torque less sliding torque, T_s - T_c
omega_s  stribeck_rad_s       Stribeck velocity
n        exponent             shape, 1 to 2
omega_0  transition_rad_s     width of the smoothed sign change (numerical)

Comes on top of Coulomb friction.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Known, LogUniform, Port


class Params(NamedTuple):
    """Zero excess switches it off."""

    excess_torque_nm: Annotated[float, LogUniform(1e-4, 0.05)] = 0.0
    stribeck_rad_s: Annotated[float, Known(0.1, 3.0)] = 1.0
    exponent: Annotated[float, Known(1.0, 2.0)] = 2.0
    transition_rad_s: Annotated[float, Known(0.05, 2.0)] = 0.2


def law(s: Any, p: Params) -> Any:
    """Torque on the motor, Nm."""
    omega = s.motor_velocity_rad_s
    over = np.abs(omega) / p.stribeck_rad_s
    power = np.where(p.exponent == 2.0, over * over, over**p.exponent)  # the usual one, quickly
    return -p.excess_torque_nm * np.exp(-power) * np.tanh(omega / p.transition_rad_s)


EFFECT = Effect(
    port=Port.MOTOR_TORQUE,
    params=Params,
    law=law,
    sample={"excess_torque_nm": 0.01},
    shows="residual concentrated below three Stribeck velocities",
    confused_with=("coulomb", "command_deadband", "pre_sliding"),
    source="Stribeck 1902; Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994)",
)
