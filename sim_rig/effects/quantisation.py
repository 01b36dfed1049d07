"""Quantisation: the load encoder reports whole counts.

    y <- q round(y / q)

q  count_rad   angle of one count, 2 pi over the counts in a revolution

Comes after all that the encoder measures wrongly.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, LogUniform, Port


class Params(NamedTuple):
    """Zero switches it off."""

    count_rad: Annotated[float, LogUniform(3e-7, 2e-3)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The reading, rad."""
    return p.count_rad * np.rint(s.measured_load_angle_rad / p.count_rad)


EFFECT = Effect(
    port=Port.LOAD_SENSOR,
    params=Params,
    law=law,
    sample={"count_rad": 2.0 * np.pi / 10000.0},
    shows="the load angle lies on a lattice; white while it turns, a staircase when it is slow",
    confused_with=("encoder_subdivision",),
    source="Widrow, Kollar, Quantization Noise (2008), ch. 5",
)
