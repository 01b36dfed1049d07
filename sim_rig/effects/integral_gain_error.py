"""Integral gain error: the drive's velocity loop is tuned otherwise than the rig's file says.

    i* = K_P (r - omega) + (1 + d) K_I x

d  error_fraction   relative error of K_I; a reset time T_N gives K_I = K_P/T_N
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, Port, Uniform


class Params(NamedTuple):
    """Zero switches it off."""

    error_fraction: Annotated[float, Uniform(-0.5, 0.5, least=-0.9)] = 0.0


def law(s: Any, p: Params) -> Any:
    """What the velocity loop asks for, A."""
    gain = s.integral_gain_a_per_rad * p.error_fraction
    return s.current_demand_a + gain * s.integral_rad


EFFECT = Effect(
    port=Port.CURRENT_DEMAND,
    params=Params,
    law=law,
    sample={"error_fraction": 0.2},
    shows="linear: wn^2 is another, 2 zeta wn is not; overshoot and its tail change",
    confused_with=("proportional_gain_error",),
    source="Ellis, Control System Design Guide (2012), ch. 6; a drive's gains are set by hand",
)
