"""Position-dependent backlash: the gap is wider at one angle of the load than at another.

    W <- max(W + b cos(theta_l - phi), 0)

b    swing_rad  how much the full width rises and falls in a revolution
phi  phase_rad  where the gap is widest
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, LogUniform, Port, Uniform


class Params(NamedTuple):
    """Zero swing switches it off."""

    swing_rad: Annotated[float, LogUniform(1e-5, 0.02)] = 0.0
    phase_rad: Annotated[float, Uniform(-np.pi, np.pi)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The gap, rad."""
    swing = p.swing_rad * np.cos(s.load_angle_rad - p.phase_rad)
    return np.maximum(s.backlash_gap_rad + swing, 0.0)


EFFECT = Effect(
    port=Port.BACKLASH_GAP,
    params=Params,
    law=law,
    sample={"swing_rad": 0.005, "phase_rad": 0.4},
    shows="locked to the drive's direction, and as large as the angle makes it",
    confused_with=("backlash_width", "encoder_eccentricity", "position_friction"),
    source="eccentric gears and couplings: 5 to 40 % of the gap (Nordin, Gutman 2002)",
)
