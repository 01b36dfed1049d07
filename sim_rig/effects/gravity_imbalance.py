"""Gravity imbalance: the load's centre of mass lies off a horizontal axis.

    tau_l = -T sin(theta_l + phi),      T = m g r

T    torque_nm   largest torque
phi  phase_rad   zero: hangs at angle zero

On a rigid load it reaches the motor while the motor pushes against it.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, LogUniform, Port, Uniform


class Params(NamedTuple):
    """Zero torque switches it off."""

    torque_nm: Annotated[float, LogUniform(1e-4, 0.1)] = 0.0
    phase_rad: Annotated[float, Uniform(-np.pi, np.pi)] = 0.0


def law(s: Any, p: Params) -> Any:
    """Torque on the load, Nm."""
    return -p.torque_nm * np.sin(s.load_angle_rad + p.phase_rad)


EFFECT = Effect(
    port=Port.LOAD_TORQUE,
    params=Params,
    law=law,
    sample={"torque_nm": 0.02, "phase_rad": 0.7},
    shows="one period in a revolution of torque; decides on which side of the gap the load lies",
    confused_with=("encoder_eccentricity", "load_torque", "position_friction"),
    source="statics",
)
