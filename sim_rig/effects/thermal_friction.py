"""Thermal friction: a cold bearing's grease is stiff, and the motor's shaft turns ever easier.

    tau = -C exp(-t / t_w) tanh(omega / omega_0)

C        cold_torque_nm    what friction at the start exceeds friction when warm by
t_w      warming_s         thermal time constant
omega_0  transition_rad_s  width of the smoothed sign change (numerical, not physical)

Comes on top of Coulomb friction, which is that of the warm rig. A record much shorter than t_w
shows Coulomb friction and no drift.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Known, LogUniform, Port


class Params(NamedTuple):
    """Zero torque switches it off."""

    cold_torque_nm: Annotated[float, LogUniform(1e-4, 0.05)] = 0.0
    warming_s: Annotated[float, Known(60.0, 1800.0)] = 600.0
    transition_rad_s: Annotated[float, Known(0.05, 2.0)] = 0.5


def law(s: Any, p: Params) -> Any:
    """Torque on the motor, Nm."""
    left = np.exp(-s.time_s / p.warming_s)
    return -p.cold_torque_nm * left * np.tanh(s.motor_velocity_rad_s / p.transition_rad_s)


EFFECT = Effect(
    port=Port.MOTOR_TORQUE,
    params=Params,
    law=law,
    sample={"cold_torque_nm": 0.01, "warming_s": 60.0},
    shows="friction that is fitted window by window falls with time",
    confused_with=("coulomb", "clock_skew", "pre_sliding"),
    source="Bittencourt, Gunnarsson, J. Dyn. Sys. Meas. Control 134 (2012): friction and warmth",
)
