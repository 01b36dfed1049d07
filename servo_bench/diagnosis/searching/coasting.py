"""A load that goes on in its gap when the motor turns back: what no drawing tells of a light one.

The rigid play lets the load stand until a face comes. A real one coasts, slowed by its own
friction, w^2/(2 a) far at speed w, with a = friction/inertia: most of a gap at 5 rad/s. It reaches
the motor by next to nothing, so friction and inertia themselves are not told apart; a cause of
these names is one that the motor feels, and found before this is asked. A face gives back the same
share of every blow, as a spring and damper do, or less the faster it is, as metal does; both are
begun with, and what a load does after a few blows tells them apart.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.searching.gate import misfit
from servo_bench.diagnosis.searching.scales import yielding
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.unknowns import Unknown, at_centres, widened
from sim_rig.effects import backlash_width
from sim_rig.errors import EffectError
from sim_rig.model import Model

WRONG, ASKED, RIGHT, NEARLY = 0.5, 0.15, 1.0, 2.0
"""Misfit of the twist from which on coasting is told, and while a cause may yet be found beside it
asked; of the motor up to which it is right; and up to which it may miss that a load which is thrown
takes its friction along, so that a soft loop runs up in the gap. The load's own angle is the
twist's where the motor is right."""
LIGHT = 0.001
"""Of the inertia: a load of which the motor feels next to nothing."""
SLOWED_RAD_S2 = (100.0, 170.0, 280.0, 460.0, 760.0, 1250.0, 2100.0, 3500.0)


class Face(NamedTuple):
    """What a face takes of a blow."""

    damping_s: float
    slope_s_per_rad: float


FACE_RAD_PER_NM = 1.5e-2
FACES = (
    *(Face(damping_s, 0.0) for damping_s in (1e-4, 3e-5, 1.2e-5)),
    *(Face(2e-6, slope_s_per_rad) for slope_s_per_rad in (0.05, 0.15, 0.45)),
)
"""A stiff face, and what it takes: from most of a blow to little, the same of all or more of the
fast. Between them no search of a few steps finds its way."""
TAKES_BOTH = Face(1.2e-5, 0.15)
"""Some of every blow and more of the fast: begun with too, where the load's encoder is alone."""
MOST_SLOPE_S_PER_RAD, BELIEVED_S_PER_RAD, SLOPED = 5.0, 0.1, 0.03
"""Of a face's slope, at most and usually; and what it takes of the cost at least where the search
began on a face without. Beside a dead time it took a thousandth, and of what was held out so much
of the advantage that the name was lost."""
GAP = "backlash_width"
GAPS, FACED = (-0.15, -0.05, 0.0, 0.05, 0.15), 3
"""Of the gap, that it is tried wrong by, on so many of the faces: how far a load goes on shows only
in the right gap."""
WORTH_IT = 0.1
"""Least share of the cost that coasting takes, or it is not what is wrong."""
OTHERWISE = frozenset({"contact", "load_friction", "load_torque", "gravity_imbalance"})
"""Effects that give the load a motion of its own already."""


def with_coasting(
    whole: Evidence, final: Found, *, to_ask: bool = True, scouted: Evidence | None = None
) -> Found:
    """The same search with a coasting load beside, where all but the twist is right; or as it was.

    Coasting is judged in the gap that fits it best. That gap is not kept where it is more than
    what every rig has: it is a cause, to be found beside a load that coasts. Until that is asked
    the load may coast and fit worse; where it is not to be asked any more, it may not.

    Where the search begins may be `scouted` on less. With the load's encoder alone what every rig
    may have was fitted to a load that stands, to the ends of its bands: of two rigs with nothing
    wrong the gap was a millirad off, and friction three times what it was. Begun with what is
    usual as well, the same search ended at 0.82 and 0.59 of the cost.
    """
    least = ASKED if to_ask else WRONG
    if not _only_the_twist(whole, final, least) or OTHERWISE & set(final.model.effects):
        return final
    hidden = whole.is_of_the_load_alone
    begun = [final.model, usual(final)] if hidden else [final.model]
    faces = (*FACES, TAKES_BOTH) if hidden else FACES
    less = whole if scouted is None else scouted
    starts = [start for model in begun for start in _starts(less, final, model, faces)]
    if not starts:
        return final
    ends = [
        seek(whole, start, (*_own(start), *_gap(start)), final.sigma, iterations=4, first=1)
        for start in starts
    ]
    alone = _sloped(whole, min(ends, key=lambda end: end.cost))
    own = [u for u in alone.unknowns if u.effect != GAP]
    rested = whole.seen([final.model])[0].cost(final.sigma)
    if alone.errors.cost(final.sigma) > (1.0 - WORTH_IT) * rested:
        return final
    unknowns = (*final.unknowns, *own)
    found = seek(whole, alone.model, unknowns, final.sigma, iterations=2, first=2)
    if hidden:
        found = seek(whole, found.model, unknowns, final.sigma, iterations=4, first=1)
    return found if to_ask or found.errors.cost(final.sigma) < rested else final


def coasting_or_rested(whole: Evidence, coasts: Found, rested: Found) -> Found:
    """The search beside a load that coasts, which was for asking, where that is to be told as well:
    else the one in which the load stands."""
    told = _only_the_twist(whole, rested, WRONG)
    lower = coasts.errors.cost(rested.sigma) < rested.errors.cost(rested.sigma)
    return coasts if told and lower else rested


def usual(found: Found) -> Model:
    """A search's model with what every rig may have as most have it: the middle of its bands."""
    return at_centres(found.model, [u for u in found.unknowns if np.isfinite(u.deviation)])


def _starts(scouted: Evidence, final: Found, begun: Model, faces: Sequence[Face]) -> list[Model]:
    """The best of some loads, in some gaps, on each of the best faces; none where one cannot be
    simulated. Of two faces the worse at the start may well be the better in the end."""
    try:
        models = [[coasting(begun, a, face) for a in SLOWED_RAD_S2] for face in faces]
    except EffectError:
        return []
    loads = [_lowest(scouted, final, on_one_face) for on_one_face in models]
    best = sorted(loads, key=lambda pair: pair[0])[:FACED]
    if begun.nominal.backlash_gap_rad <= 0.0:
        return [model for _, model in best]
    gaps = [[_in_gap(model, share) for share in GAPS] for _, model in best]
    return [_lowest(scouted, final, wider)[1] for wider in gaps]


def _lowest(scouted: Evidence, final: Found, models: Sequence[Model]) -> tuple[float, Model]:
    costs = [errors.cost(final.sigma) for errors in scouted.seen(models)]
    return min(zip(costs, models, strict=True), key=lambda pair: pair[0])


def _gap(model: Model) -> tuple[Unknown, ...]:
    """The gap, as free as a cause's."""
    gap_rad = model.nominal.backlash_gap_rad
    return widened(GAP, ("change_rad",), model, 0.1 * gap_rad) if gap_rad > 0.0 else ()


def _in_gap(model: Model, share: float) -> Model:
    """The model in a gap that is wrong by so much more of the nominal one."""
    now = model.effects.get(GAP, backlash_width.Params())
    more = share * model.nominal.backlash_gap_rad
    return model.with_effect(GAP, change_rad=float(now.change_rad) + more)


def coasting(model: Model, slowed_rad_s2: float, face: Face = FACES[0]) -> Model:
    """The model with a light load that is slowed so much in its gap, by friction that was taken for
    the motor's: while both turn together it is."""
    inertia = LIGHT * model.nominal.inertia_kg_m2
    model = model.with_effect(
        "contact",
        compliance_rad_per_nm=FACE_RAD_PER_NM * yielding(model.nominal.inertia_kg_m2),
        load_inertia_kg_m2=inertia,
        damping_s=face.damping_s,
        restitution_slope_s_per_rad=face.slope_s_per_rad,
    )
    friction_nm = slowed_rad_s2 * inertia
    return _friction(friction_nm).put(model.with_effect("load_friction"), friction_nm)


def _friction(size_nm: float, most_nm: float = np.inf) -> Unknown:
    """The load's, of which the motor's own has so much less."""
    name, step_nm = ("load_friction", "torque_nm"), 0.3 * size_nm
    return Unknown(*name, 0.0, most_nm, step_nm, carries="coulomb.torque_nm", share=1.0)


def is_coasting(model: Model) -> bool:
    """Whether a model has a load that coasts as a nuisance."""
    contact = model.effects.get("contact")
    light = LIGHT * model.nominal.inertia_kg_m2
    return contact is not None and contact.load_inertia_kg_m2 == light


def slowing_rad_s2(model: Model) -> float:
    """How fast the load is slowed in its gap."""
    inertia = model.effects["contact"].load_inertia_kg_m2
    return float(model.effects["load_friction"].torque_nm) / float(inertia)


def given_back(model: Model, speed_rad_s: float) -> float:
    """Share of a blow's speed with which the load leaves its face, 0 to 1.

    Of a spring and damper that pushes and never pulls, at a damping ratio z (Schwager, Poeschel,
    Granular Matter 9 (2007) 465): exp(-z a/w), w^2 = 1 - z^2, a = atan2(2 z w, 2 z^2 - 1); and of
    that what the contact's slope leaves.
    """
    contact = model.effects["contact"]
    slow = _of_a_slow_blow(contact)
    return slow / (1.0 + float(contact.restitution_slope_s_per_rad) * slow * speed_rad_s)


def _of_a_slow_blow(contact: Any) -> float:
    swing_s = np.sqrt(contact.compliance_rad_per_nm * contact.load_inertia_kg_m2)
    ratio = 0.5 * float(contact.damping_s) / float(swing_s)
    root = np.sqrt(abs(1.0 - ratio**2))
    if root < 1e-6:
        return float(np.exp(-2.0))
    if ratio > 1.0:
        return float(((ratio - root) / (ratio + root)) ** (ratio / root))
    return float(np.exp(-ratio * np.arctan2(2.0 * ratio * root, 2.0 * ratio**2 - 1.0) / root))


def _own(model: Model) -> tuple[Unknown, ...]:
    friction = float(model.effects["load_friction"].torque_nm)
    most = 10.0 * max(SLOWED_RAD_S2) * LIGHT * model.nominal.inertia_kg_m2
    face = FACE_RAD_PER_NM * yielding(model.nominal.inertia_kg_m2)
    contact = model.effects["contact"]
    damping, slope = float(contact.damping_s), float(contact.restitution_slope_s_per_rad)
    return (
        _friction(friction, most),
        Unknown("contact", "compliance_rad_per_nm", 0.02 * face, 10.0 * face, step=0.4 * face),
        Unknown("contact", "damping_s", 0.0, 2e-3, step=0.5 * damping),
        *((_slope(slope),) if slope > 0.0 else ()),
    )


def _slope(size_s_per_rad: float) -> Unknown:
    name, step = "restitution_slope_s_per_rad", 0.5 * size_s_per_rad
    most, usual = MOST_SLOPE_S_PER_RAD, BELIEVED_S_PER_RAD
    return Unknown("contact", name, 0.0, most, step=step, deviation=usual)


def _sloped(whole: Evidence, found: Found) -> Found:
    """The search with the slope free as well, where that is worth it: damping and slope do much the
    same, and where little is to be told of them a number more fits chance."""
    slope = _slope(BELIEVED_S_PER_RAD)
    if slope.name in {u.name for u in found.unknowns}:
        return found
    freed = (*found.unknowns, slope)
    sloped = seek(whole, found.model, freed, found.sigma, iterations=3, first=1)
    return sloped if sloped.cost < (1.0 - SLOPED) * found.cost else found


def _only_the_twist(whole: Evidence, final: Found, least: float) -> bool:
    """Whether the twist misses so much, and nothing before the gap much more than it may; of the
    load's encoder alone, whether that misses as much as is asked."""
    missed = misfit(whole, final.errors)
    twist, load = (
        np.array([name.startswith(angle) for name in whole.names]) for angle in ("twist", "load")
    )
    if not twist.any():  # nothing tells what is before the gap from what is behind it
        return bool(load.any() and missed[load].max() > ASKED)
    before = missed[~(twist | load)].max(initial=0.0)
    asked = least if before < RIGHT else ASKED
    return bool(missed[twist].max() > asked and missed[~twist].max(initial=0.0) < NEARLY)
