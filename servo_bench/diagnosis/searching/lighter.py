"""A load that was given a mass of its own, where one that only coasts would do.

Friction of the load decides how far it goes on in its gap, and the motor hardly feels it. Where
nothing was named yet it is taken for a cause together with a mass, at whatever size; every rig has
some of both (`coasting`). So once everything is fitted that is tried in its place.
"""

from collections.abc import Sequence

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.searching.coasting import OTHERWISE, is_coasting, with_coasting
from servo_bench.diagnosis.searching.hypotheses import VEHICLE
from servo_bench.diagnosis.searching.joint import Named, fit_jointly, is_needed
from servo_bench.diagnosis.searching.rounds import Told
from servo_bench.diagnosis.searching.seeking import Found, seek, settle
from servo_bench.diagnosis.searching.unknowns import Unknown, merged

FRICTION = "load_friction"
LOAD = frozenset({VEHICLE, FRICTION})


def on_a_light_load(
    whole: Evidence, final: Found, named: list[Named], band: Sequence[Unknown], report: Told
) -> tuple[Found, list[Named]]:
    """The joint fit, with a load that only coasts instead of what was found of the load; or as it
    was where that is needed, or carries another cause."""
    load = OTHERWISE & final.model.effects.keys()
    if load != LOAD or is_coasting(final.model):
        return final, named
    report("a load that only coasts")
    light = with_coasting(whole, _rigid(whole, final, band), to_ask=False)
    if not is_coasting(light.model):
        return final, named
    light = settle(whole, light, LOAD, turns=3)
    if is_needed(final, light):
        return final, named
    return fit_jointly(whole, light, [n for n in named if n.effect not in LOAD], band, report)


def _rigid(whole: Evidence, final: Found, band: Sequence[Unknown]) -> Found:
    """The same search without what was found of the load; its friction is the motor's again."""
    model = final.model.without(*LOAD)
    kept = tuple(u for u in final.unknowns if u.effect not in LOAD)
    names = {u.name for u in kept}
    usual = tuple(u for u in band if u.name not in names)
    for unknown in usual:
        value = float(np.clip(unknown.of(final.model), unknown.low, unknown.high))
        model = unknown.put(model, value)
    return seek(whole, model, merged(usual, kept), final.sigma, iterations=4, first=1)
