"""Load-dependent friction: bearings and teeth rub in proportion to the torque they carry.

    tau = -mu |tau_e| tanh(omega / omega_0)

mu       loss_fraction     share of the carried torque that is lost
tau_e    -                 torque that the current makes: all of the inertia lies behind it
omega_0  transition_rad_s  width of the smoothed sign change (numerical, not physical)

While driving, the torque counts 1 - mu; while braking, 1 + mu: what a drive train's efficiency
means. At constant velocity without load it vanishes.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Known, LogUniform, Port


class Params(NamedTuple):
    """Zero loss switches it off."""

    loss_fraction: Annotated[float, LogUniform(2e-3, 0.3, most=0.99)] = 0.0
    transition_rad_s: Annotated[float, Known(0.05, 2.0)] = 0.5


def law(s: Any, p: Params) -> Any:
    """Torque on the motor, Nm."""
    side = np.tanh(s.motor_velocity_rad_s / p.transition_rad_s)
    return -p.loss_fraction * np.abs(s.electric_torque_nm) * side


EFFECT = Effect(
    port=Port.MOTOR_TORQUE,
    params=Params,
    law=law,
    sample={"loss_fraction": 0.1},
    shows="only while accelerating or braking: the torque constant seems lower, then higher",
    confused_with=("coulomb", "viscous"),
    source="Bittencourt, Gunnarsson, J. Dyn. Sys. Meas. Control 134 (2012): load in joint friction",
)
