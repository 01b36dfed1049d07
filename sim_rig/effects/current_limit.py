"""Current limit: the drive's peak current.

    i* <- min(max(i*, -I), I),      I = 1 / s

s  limit_per_a   one over the limit; zero for none
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, LogUniform, Port


class Params(NamedTuple):
    """Zero, an infinite limit, switches it off."""

    limit_per_a: Annotated[float, LogUniform(1.0 / 100.0, 1.0 / 3.0)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The limited current command, A."""
    limit = 1.0 / p.limit_per_a
    return np.minimum(np.maximum(s.current_command_a, -limit), limit)


EFFECT = Effect(
    port=Port.CURRENT_COMMAND,
    params=Params,
    law=law,
    sample={"limit_per_a": 1.0 / 5.0},
    shows="only after large reversals: acceleration is capped, a knee in its histogram",
    confused_with=("command_slew", "integrator_clamp", "torque_constant_droop", "anti_windup"),
    source="IEC 61800-7-201 (CiA 402), objects 0x6072 and 0x6073",
)
