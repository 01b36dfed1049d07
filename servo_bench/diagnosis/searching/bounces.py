"""A load's bounces: nobody knows the law of the faces, and a search ends in many valleys.

A load with a mass meets a face many times a second, and each bounce begins where the last one
ended: a face that is twice as stiff, or takes half as much of a blow, leaves the motor as it is and
sends the load elsewhere in its gap, one that only coasts as well. The contact of the catalogue is
linear but for what it takes of a blow's speed and real ones are not (Hertz, Hunt and Crossley), so
no numbers of it are right for every blow. What such a factor changes is therefore no sign of a
wrong cause.
"""

from collections.abc import Collection
from itertools import product

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence, changed_by
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.searching.hypotheses import VEHICLE
from servo_bench.diagnosis.searching.seeking import Found, seek, settle
from sim_rig.model import Model

OTHERWISE = (0.5, 2.0)
"""Of a face's stiffness, damping, and slope: Hertz's law makes it of blows eight times as hard or
soft."""
NUMBERS = ("compliance_rad_per_nm", "damping_s", "restitution_slope_s_per_rad")
MOST = 3.0
"""Of what a right simulation may miss anyway: what is more than that is not known at all."""

FACES, TURNS, BETTER = ((2.0, 1.0), (4.0, 2.0), (0.5, 1.0)), 3, 0.03
"""Softness, and damping and slope, of other faces, times those of a search's end, that it goes on
from; how often, while it gets better by such a share."""


def on_other_faces(whole: Evidence, found: Found, own: Collection[str]) -> Found:
    """The best of searches that go on from other faces than those on which one ended.

    Their valleys are long and side by side: where a load is the cause and the simulation is not
    right yet, the search is seldom at its end.
    """
    best = seek(whole, found.model, found.unknowns, found.sigma, iterations=1, first=3)
    for _ in range(TURNS):
        ends = [_settled(whole, best, _other(best.model, *times), own) for times in FACES]
        before, best = best.cost, min([best, *ends], key=lambda end: end.cost)
        if best.cost > (1.0 - BETTER) * before:
            break
    fine = seek(whole, best.model, found.unknowns, found.sigma, iterations=2, first=3, coarse=False)
    return min(fine, found, key=lambda end: end.cost)


def _settled(whole: Evidence, found: Found, start: Model, own: Collection[str]) -> Found:
    end = seek(whole, start, found.unknowns, found.sigma, iterations=4, first=1)
    return settle(whole, end, own, turns=1)


def _other(model: Model, softer: float, damped: float) -> Model:
    params = model.effects[VEHICLE]._asdict()
    times = dict(zip(NUMBERS, (softer, damped, damped), strict=True))
    return model.with_effect(VEHICLE, **params | {k: v * params[k] for k, v in times.items()})


def bounces(whole: Evidence, model: Model) -> Array:
    """Robust change of every signal by other faces, the largest of all, within `MOST`; zeros
    without a load of its own. Shape (signals,).
    """
    if VEHICLE not in model.effects:
        return np.zeros(len(whole.names))
    params = model.effects[VEHICLE]._asdict()
    others = [
        model.with_effect(VEHICLE, **{**params, name: times * params[name]})
        for name, times in product(NUMBERS, OTHERWISE)
        if params[name] > 0.0
    ]
    return np.asarray(np.minimum(changed_by(whole, model, others), MOST * whole.allowed))
