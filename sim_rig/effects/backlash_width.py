"""Backlash width: the gap is wider or narrower than nominal.

    W <- max(W + d, 0)

d  change_rad   difference of the full width
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Port, Uniform


class Params(NamedTuple):
    """Zero change switches it off."""

    change_rad: Annotated[float, Uniform(-0.02, 0.02)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The gap, rad."""
    return np.maximum(s.backlash_gap_rad + p.change_rad, 0.0)


EFFECT = Effect(
    port=Port.BACKLASH_GAP,
    params=Params,
    law=law,
    sample={"change_rad": 0.005},
    shows="half the change, locked to the drive's direction once the gap is crossed",
    confused_with=("position_backlash", "coupling_compliance", "contact"),
    source="Nordin, Gutman, Automatica 38 (2002)",
)
