"""Position-dependent friction: the motor's shaft turns harder at one angle than at another.

    tau = -A cos(theta - phi) tanh(omega / omega_0)

A        swing_torque_nm   how much friction rises and falls in a revolution
phi      phase_rad         where it is largest
omega_0  transition_rad_s  width of the smoothed sign change (numerical, not physical)

Comes on top of Coulomb friction, T (1 + a cos ...) with A = a T, and is friction only while T is
larger than A.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Known, LogUniform, Port, Uniform


class Params(NamedTuple):
    """Zero swing switches it off."""

    swing_torque_nm: Annotated[float, LogUniform(1e-4, 0.02)] = 0.0
    phase_rad: Annotated[float, Uniform(-np.pi, np.pi)] = 0.0
    transition_rad_s: Annotated[float, Known(0.05, 2.0)] = 0.5


def law(s: Any, p: Params) -> Any:
    """Torque on the motor, Nm."""
    side = np.tanh(s.motor_velocity_rad_s / p.transition_rad_s)
    return -p.swing_torque_nm * np.cos(s.motor_angle_rad - p.phase_rad) * side


EFFECT = Effect(
    port=Port.MOTOR_TORQUE,
    params=Params,
    law=law,
    sample={"swing_torque_nm": 0.008, "phase_rad": 0.4},
    beside={"coulomb": {"torque_nm": 0.02}},
    shows="one period in a revolution that changes sign with the direction of turning",
    confused_with=("gravity_imbalance", "encoder_eccentricity", "position_backlash"),
    source="Armstrong-Helouvry, Control of Machines with Friction (1991), ch. 3",
)
