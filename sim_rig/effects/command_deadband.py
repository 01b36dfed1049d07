"""Command deadband: the drive takes a small velocity command for none.

    r <- 0 where |r| < d

d  deadband_rad_s   largest command that is not followed

A command of one size cannot show it: play several, and small ones.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, LogUniform, Port


class Params(NamedTuple):
    """Zero switches it off."""

    deadband_rad_s: Annotated[float, LogUniform(1e-3, 3.0)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The command that is followed, rad/s."""
    return np.where(np.abs(s.command_rad_s) < p.deadband_rad_s, 0.0, s.command_rad_s)


EFFECT = Effect(
    port=Port.COMMAND,
    params=Params,
    law=law,
    sample={"deadband_rad_s": 4.0},
    shows="residual under small commands only, as large as they are",
    confused_with=("stribeck", "command_scale"),
    source="manuals of drives with an analogue input: 0.01 to 1 % of full scale",
)
