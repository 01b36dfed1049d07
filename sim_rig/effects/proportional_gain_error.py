"""Proportional gain error: the drive's velocity loop is tuned otherwise than the rig's file says.

    i* = (1 + d) K_P (r - omega) + K_I x

d  error_fraction   relative error of K_P
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, Port, Uniform


class Params(NamedTuple):
    """Zero switches it off."""

    error_fraction: Annotated[float, Uniform(-0.5, 0.5, least=-0.9)] = 0.0


def law(s: Any, p: Params) -> Any:
    """What the velocity loop asks for, A."""
    gain = s.proportional_gain_a_s_per_rad * p.error_fraction
    return s.current_demand_a + gain * s.velocity_error_rad_s


EFFECT = Effect(
    port=Port.CURRENT_DEMAND,
    params=Params,
    law=law,
    sample={"error_fraction": 0.1},
    shows="linear: 2 zeta wn is another, wn^2 is not; current against velocity error has its slope",
    confused_with=("viscous", "integral_gain_error", "velocity_filter_lag"),
    source="Ellis, Control System Design Guide (2012), ch. 6; a drive's gains are set by hand",
)
