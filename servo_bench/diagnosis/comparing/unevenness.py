"""What a shaft's uneven torque does to a loop that cannot answer it.

No bearing turns evenly, and a loop's integrator takes what is slow of it away before it is seen.
Where the found cause holds the integrator (a clamp, a limit that is reached all the time), nothing
does: the same torque moves the motor's speed by K_T K_P, and its angle for good. What a right
simulation may miss was found on loops whose integrator works; this is what such a model may miss
more, and next to nothing on the others.
"""

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence, changed_by
from servo_bench.diagnosis.comparing.rows import Array
from sim_rig.model import Model

SHARE = 0.004
"""Of rms torque: about half of the smallest cogging that is worth a name."""
PHASES_RAD = (0.0, 0.5 * np.pi)
MOST = 6.0
"""Of what a right simulation may miss anyway: a loop that yields to more tells nothing there."""


def unevenness(whole: Evidence, model: Model, torque_nm: float) -> Array:
    """Robust change of every signal by a torque once a turn, `SHARE` of `torque_nm` (rms), the
    larger of two phases, within `MOST`. Shape (signals,); zeros where the model has cogging of its
    own, and for a signal without a point.
    """
    if "cogging" in model.effects:
        return np.zeros(len(whole.names))
    others = [
        model.with_effect("cogging", torque_nm=SHARE * torque_nm, order=1.0, phase_rad=phase)
        for phase in PHASES_RAD
    ]
    return np.asarray(np.minimum(changed_by(whole, model, others), MOST * whole.allowed))
