"""Coulomb friction: at the motor's shaft.

    tau = -T tanh(omega / omega_0)

T        torque_nm         sliding torque
omega_0  transition_rad_s  width of the smoothed sign change (numerical, not physical)

Smooth, so not valid at standstill: it creeps and cannot hold a load (see pre_sliding).
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Known, LogUniform, Port


class Params(NamedTuple):
    """Zero torque switches it off."""

    torque_nm: Annotated[float, LogUniform(1e-4, 0.1)] = 0.0
    transition_rad_s: Annotated[float, Known(0.05, 2.0)] = 0.5


def law(s: Any, p: Params) -> Any:
    """Torque on the motor, Nm."""
    return -p.torque_nm * np.tanh(s.motor_velocity_rad_s / p.transition_rad_s)


EFFECT = Effect(
    port=Port.MOTOR_TORQUE,
    params=Params,
    law=law,
    sample={"torque_nm": 0.02},
    shows="odd in velocity; a residual of the same size after each reversal, whatever the level",
    confused_with=(
        "viscous",
        "stribeck",
        "load_friction",
        "pre_sliding",
        "thermal_friction",
        "load_dependent_friction",
    ),
    source="Coulomb 1785; Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994)",
)
