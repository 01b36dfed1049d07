"""Command deadband: the drive takes a small velocity command for none.

    r <- 0 where |r| < d,   r - k d sign(r) elsewhere

d  deadband_rad_s    largest command that is not followed
k  offset_fraction   what is taken off the commands that are followed, as a share of d: drives have
                     both kinds, 0 (zero clamp: what is larger passes as it is) and 1 (dead zone:
                     the command begins at zero behind the band)

A drive that offers the choice comes with 0, and 0 it is here. A command of one size cannot show
it, nor which kind it is: play several, and small ones.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, LogUniform, Port, Uniform


class Params(NamedTuple):
    """Zero switches it off."""

    deadband_rad_s: Annotated[float, LogUniform(1e-3, 3.0)] = 0.0
    offset_fraction: Annotated[float, Uniform(0.0, 1.0, least=0.0, most=1.0)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The command that is followed, rad/s."""
    followed = s.command_rad_s - p.offset_fraction * p.deadband_rad_s * np.sign(s.command_rad_s)
    return np.where(np.abs(s.command_rad_s) < p.deadband_rad_s, 0.0, followed)


EFFECT = Effect(
    port=Port.COMMAND,
    params=Params,
    law=law,
    sample={"deadband_rad_s": 4.0},
    shows="residual under small commands only, as large as they are",
    confused_with=("stribeck", "command_scale"),
    source="Kollmorgen AKD, AIN.DEADBANDMODE 0 and 1; Yaskawa Sigma, zero clamp Pn501",
)
