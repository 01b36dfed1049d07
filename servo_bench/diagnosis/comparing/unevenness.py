"""What a shaft's uneven torque does to a loop that cannot answer it.

No bearing turns evenly, no magnet leaves its tooth freely, and no friction is exactly Coulomb's. A
loop's integrator takes what is slow of it away before it is seen. Where the found cause holds the
integrator (a clamp, a limit that is reached all the time), nothing does: the same torque moves the
motor's speed by K_T K_P, and its angle for good. So it does, somewhat quicker, where a loop is
soft. What a right simulation may miss was found on loops that are stiff and whose integrator works;
this is what such a model may miss more, and nothing on the others.
"""

from collections.abc import Sequence

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence, changed_by
from servo_bench.diagnosis.comparing.rows import Array
from sim_rig.effects import coulomb
from sim_rig.model import Model

SHARE = 0.004
"""Of a usual torque: about half of the smallest cogging that is worth a name."""
ORDERS = (1.0, 6.0, 24.0)
"""Periods a revolution: of a bearing and a shaft, and of magnets that hold to teeth."""
PHASES_RAD = (0.0, 0.5 * np.pi)
USUAL, MOST = 0.5, 6.0
"""Of what a right simulation may miss anyway: so much is what stiff loops yield, and in it already;
and a loop that yields to more tells nothing there."""


def unevenness(whole: Evidence, model: Model, torque_nm: float) -> Array:
    """Robust change of every signal by torques at `ORDERS` and by a friction that is as much more,
    each `SHARE` of `torque_nm` (rms), beyond `USUAL` and within `MOST`. Shape (signals,); zeros
    where the model has cogging of its own, and for a signal without a point.
    """
    if "cogging" in model.effects:
        return np.zeros(len(whole.names))
    size_nm = SHARE * torque_nm
    tried = [*(lines(model, size_nm, order) for order in ORDERS), [_rubbing(model, size_nm)]]
    changed = np.linalg.norm([changed_by(whole, model, others) for others in tried], axis=0)
    beyond = np.maximum(changed**2 - (USUAL * whole.allowed) ** 2, 0.0)
    return np.asarray(np.minimum(np.sqrt(beyond), MOST * whole.allowed))


def lines(model: Model, torque_nm: float, order: float) -> Sequence[Model]:
    """The model with a torque at that order, in two phases of which one is about the worst."""
    return [
        model.with_effect("cogging", torque_nm=torque_nm, order=order, phase_rad=phase)
        for phase in PHASES_RAD
    ]


def _rubbing(model: Model, torque_nm: float) -> Model:
    now = model.effects.get("coulomb", coulomb.Params())
    return model.with_effect("coulomb", torque_nm=float(now.torque_nm) + torque_nm)
