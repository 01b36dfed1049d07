"""Anti-windup: while the current is limited, the integrator is wound back (back-calculation).

    dz/dt <- dz/dt + b (i_lim - i*) / K_I

b      tracking_per_s  one over the tracking time
i*     -               current that the loop asks for;  i_lim  what its limit leaves of it

Acts beside a current limit only. Large b is conditional integration. An integrator_clamp does
something else: it limits the integrator's state at all times.
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, LogUniform, Port


class Params(NamedTuple):
    """Zero switches it off."""

    tracking_per_s: Annotated[float, LogUniform(1.0, 2e3)] = 0.0


def law(s: Any, p: Params) -> Any:
    """What the integrator integrates, rad/s."""
    cut_a = s.current_command_a - s.current_demand_a
    return s.integral_rate_rad_s + p.tracking_per_s * cut_a / s.integral_gain_a_per_rad


EFFECT = Effect(
    port=Port.INTEGRAL_RATE,
    params=Params,
    law=law,
    sample={"tracking_per_s": 200.0},
    beside={"current_limit": {"limit_per_a": 1.0 / 5.0}},
    shows="after the current was limited: the overshoot's tail is shorter",
    confused_with=("integrator_clamp", "current_limit"),
    source="Astrom, Hagglund, Advanced PID Control (2006), section 3.5",
)
