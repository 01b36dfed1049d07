"""Viscous friction: at the motor's shaft.

    tau = -B omega

B  damping_nm_s_per_rad  torque per velocity
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, LogUniform, Port


class Params(NamedTuple):
    """Zero damping switches it off."""

    damping_nm_s_per_rad: Annotated[float, LogUniform(1e-6, 1e-2)] = 0.0


def law(s: Any, p: Params) -> Any:
    """Torque on the motor, Nm."""
    return -p.damping_nm_s_per_rad * s.motor_velocity_rad_s


EFFECT = Effect(
    port=Port.MOTOR_TORQUE,
    params=Params,
    law=law,
    sample={"damping_nm_s_per_rad": 2e-3},
    shows="linear: the best linear approximation changes, no odd distortion",
    confused_with=(
        "coulomb",
        "torque_constant_error",
        "current_loop_lag",
        "load_friction",
        "load_dependent_friction",
        "proportional_gain_error",
    ),
    source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994)",
)
