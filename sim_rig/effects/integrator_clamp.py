"""Integrator clamp: the velocity loop's integrator holds no more than a given current.

    K_I x <- min(max(K_I x, -I), I),      I = 1 / s

s  clamp_per_a   one over the clamp; zero for none
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, LogUniform, Port


class Params(NamedTuple):
    """Zero, an infinite clamp, switches it off."""

    clamp_per_a: Annotated[float, LogUniform(1.0 / 50.0, 2.0)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The integrator's state, rad."""
    clamp = 1.0 / (p.clamp_per_a * s.integral_gain_a_per_rad)
    return np.minimum(np.maximum(s.integral_rad, -clamp), clamp)


EFFECT = Effect(
    port=Port.INTEGRAL,
    params=Params,
    law=law,
    sample={"clamp_per_a": 1.0},
    shows="only after long runs or saturation: the overshoot's tail is shorter",
    confused_with=("current_limit", "anti_windup"),
    source="Astrom, Hagglund, Advanced PID Control (2006), section 3.5",
)
