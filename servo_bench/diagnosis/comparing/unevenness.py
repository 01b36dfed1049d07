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
from sim_rig.effects import cogging, coulomb
from sim_rig.effects.cogging import PLACES
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
    each `SHARE` of `torque_nm` (rms), beyond `USUAL` and within `MOST`. Shape (signals,); zero for
    a signal without a point. Of the orders that the model's own cogging has, none is asked.
    """
    size_nm = SHARE * torque_nm
    has = {order for _, order in _own(model)}
    orders = [order for order in ORDERS if order not in has]
    roomy = with_room(model)
    changes = [changed_by(whole, roomy, lines(roomy, size_nm, order)) for order in orders]
    changes.append(changed_by(whole, model, [_rubbing(model, size_nm)]))
    changed = np.linalg.norm(changes, axis=0)
    beyond = np.maximum(changed**2 - (USUAL * whole.allowed) ** 2, 0.0)
    return np.asarray(np.minimum(np.sqrt(beyond), MOST * whole.allowed))


def lines(model: Model, torque_nm: float, order: float) -> Sequence[Model]:
    """The model, which has room for one, with a torque at that order too, in two phases of which
    one is about the worst."""
    params = model.effects.get("cogging", cogging.Params())
    slot = next(p for p in PLACES if getattr(params, f"{p}torque_nm") == 0.0)
    kept = params._asdict()
    return [
        model.with_effect(
            "cogging",
            **{
                **kept,
                f"{slot}torque_nm": torque_nm,
                f"{slot}order": order,
                f"{slot}phase_rad": phase,
            },
        )
        for phase in PHASES_RAD
    ]


def with_room(model: Model) -> Model:
    """The model, without its last line where every place has one: what a further one changes is
    hardly another beside two lines than beside three."""
    if len(_own(model)) < len(PLACES):
        return model
    kept = model.effects["cogging"]._asdict() | {f"{PLACES[-1]}torque_nm": 0.0}
    return model.with_effect("cogging", **kept)


def _own(model: Model) -> Sequence[tuple[float, float]]:
    """Torque and order of the model's own lines."""
    params = model.effects.get("cogging", cogging.Params())
    found = [(getattr(params, f"{p}torque_nm"), getattr(params, f"{p}order")) for p in PLACES]
    return [(float(torque), float(order)) for torque, order in found if torque != 0.0]


def _rubbing(model: Model, torque_nm: float) -> Model:
    now = model.effects.get("coulomb", coulomb.Params())
    return model.with_effect("coulomb", torque_nm=float(now.torque_nm) + torque_nm)
