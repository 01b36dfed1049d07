"""Asymmetric friction: the motor's shaft turns harder one way than the other.

    tau = -D tanh(omega / omega_0)^2

D        difference_torque_nm  half of what friction forwards exceeds friction backwards by
omega_0  transition_rad_s      width of the smoothed sign change (numerical, not physical)

Comes on top of Coulomb friction, T + D forwards and T - D backwards, and is friction only while
T is larger than D. A constant torque but for standstill: without a dwell there, or a gap, nobody
can tell it from load_torque.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Known, Port, Uniform


class Params(NamedTuple):
    """Zero difference switches it off."""

    difference_torque_nm: Annotated[float, Uniform(-0.02, 0.02)] = 0.0
    transition_rad_s: Annotated[float, Known(0.05, 2.0)] = 0.5


def law(s: Any, p: Params) -> Any:
    """Torque on the motor, Nm."""
    side = np.tanh(s.motor_velocity_rad_s / p.transition_rad_s)
    return -p.difference_torque_nm * side * side


EFFECT = Effect(
    port=Port.MOTOR_TORQUE,
    params=Params,
    law=law,
    sample={"difference_torque_nm": 0.005},
    beside={"coulomb": {"torque_nm": 0.02}},
    shows="even in velocity: the mean current is not zero, even-order distortion",
    confused_with=("load_torque",),
    source="Armstrong-Helouvry, Control of Machines with Friction (1991), ch. 2: 5 to 20 %",
)
