"""A name that stands only while what every rig has is held in its band is none.

Every fit has some numbers free within bands (`unknowns.nuisances`). Where the catalogue has an
effect of that name, more of it is a cause, which has been asked beside all the others. Where it was
left out, more of it can only end at its band's end, and a neighbour may take the rest: a lag what a
delay lacks, a gain what damping lacks, friction that warms what Coulomb friction lacks. So those
bands are let go, and a cause that is not missed then, or for little, has no name. A coupling fits a
part of whatever is wrong: beside one all bands at whose end the fit stands are let go, asked or
not.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.searching.classes import class_of
from servo_bench.diagnosis.searching.contenders import REFINES
from servo_bench.diagnosis.searching.hypotheses import SPRINGS, VEHICLE
from servo_bench.diagnosis.searching.joint import (
    CARRIERS,
    Named,
    carried_by,
    is_missed,
    is_needed,
    share_of,
    without_effect,
)
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.unknowns import WIDE, Unknown
from sim_rig.effects import find_effect
from sim_rig.errors import EffectError
from sim_rig.model import Model

AT_ITS_END = 0.95
"""Of its band, on which a nuisance is held back by nothing but that."""
KEEPS = 0.3
"""Of the share that a cause takes: what is left of it beside what was let go. A gain that stood in
for damping kept 0.13, causes that were there 0.9 and more."""
SPRING_KEEPS = 0.75
"""The same of a coupling, which may stand in for more: beside a large friction of the load one kept
0.64, for a little damping 0.57; couplings that were there 0.92 and more."""
WITH, WITHOUT = 3, 4
"""Iterations of a search with every cause, and of one without, which has further to go."""


class Doubt(NamedTuple):
    """A cause, and what every rig has and more of which would do as well."""

    effect: str
    instead: tuple[str, ...]


def stands_at_its_end(unknown: Unknown, value: float) -> bool:
    """Whether a number is held back by its band alone."""
    if not np.isfinite(unknown.deviation):
        return False
    middle = 0.5 * (unknown.low + unknown.high) if unknown.low != 0.0 else 0.0
    room = (1.0 - AT_ITS_END) * (unknown.high - middle)
    return value > unknown.high - room or (unknown.low != 0.0 and value < unknown.low + room)


def without_stand_ins(
    whole: Evidence, final: Found, named: Sequence[Named], band: Sequence[Unknown]
) -> tuple[Found, list[Named]]:
    """The fit without couplings that are not missed, or not where every band at whose end it stands
    is let go: three free numbers take what a little more damping or lag would. Nothing is wrong
    then."""
    kept = list(named)
    for one in named:
        if one.effect not in SPRINGS - {VEHICLE}:
            continue
        free = [u for u in band if _holds(u, one.effect, final)]
        try:
            less = without_effect(whole, final, one.effect, band)
            needed = is_needed(final, less)
            if needed and free:
                needed = not _instead(
                    whole, final, one.effect, band, free, less=less, keeps=SPRING_KEEPS
                )
        except EffectError:  # the others need it: a load's friction, the load behind it
            continue
        if not needed:
            final = less
            kept.remove(one)
    return final, kept


def without_idle(
    whole: Evidence, final: Found, named: Sequence[Named], band: Sequence[Unknown]
) -> tuple[Found, list[Named]]:
    """The fit without what acts beside another only, where that alone would do.

    The other has its name where it competed too. Where it did not, the two stood in for something
    else together: of a K_T that droops, and of a supply that sags, an anti-windup with its limit
    took 42 and 23 % of what was held out, and was not missed beside the limit.
    """
    kept = list[Named]()
    for one in named:
        kept.append(one)
        carrier = CARRIERS.get(one.effect)
        if carrier is None or any(n.effect == carrier for n in named):
            continue
        less = without_effect(whole, final, one.effect, band)
        if is_needed(final, less):
            continue
        kept.pop()
        if any(c.effect == carrier for c in one.round.contenders):
            final = less
            kept.append(carried_by(one, carrier))
        else:
            final = without_effect(whole, less, carrier, band)
    return final, kept


def doubts(
    whole: Evidence,
    final: Found,
    named: Sequence[Named],
    band: Sequence[Unknown],
    asked: Collection[str],
) -> tuple[Doubt, ...]:
    """The causes that are not missed where the bands of what was not `asked` are let go."""
    found = []
    for effect in dict.fromkeys(n.effect for n in named):
        free = [u for u in band if u.effect not in asked and _holds(u, effect, final)]
        if not free:
            continue
        try:
            less = without_effect(whole, final, effect, band)
            if not is_missed(whole, final, less, effect, named):
                continue  # nor before: a gap that is wrong within its band
            instead = _instead(whole, final, effect, band, free, less=less)
        except EffectError:  # the others need it
            continue
        found += [Doubt(effect, instead)] if instead else []
    return tuple(found)


def _holds(unknown: Unknown, effect: str, final: Found) -> bool:
    """Whether a band may have made a cause of what is more of its own; a class shares one number,
    and a refinement has all that is plain in itself."""
    if unknown.effect in class_of(effect) or unknown.name not in {u.name for u in final.unknowns}:
        return False
    plain = REFINES.get(effect) == unknown.effect
    return plain or stands_at_its_end(unknown, final.value(unknown.name))


def _instead(
    whole: Evidence,
    final: Found,
    effect: str,
    band: Sequence[Unknown],
    free: Sequence[Unknown],
    *,
    less: Found,
    keeps: float = KEEPS,
) -> tuple[str, ...]:
    """What does as well as an effect, which `less` is without, where it is `free`; nothing where
    the effect is missed all the same."""
    names = {u.name for u in free}
    unknowns = [_let_go(u) if u.name in names else u for u in final.unknowns]
    usual = [_let_go(u) if u.name in names else u for u in band]
    start = _in_its_shape(final.model, effect)
    more = seek(whole, start, unknowns, final.sigma, iterations=WITH)
    instead = without_effect(whole, more, effect, usual, iterations=WITHOUT)
    loses = share_of(more, instead) < keeps * share_of(final, less)
    if is_needed(more, instead) and not loses:
        return ()
    beyond = [u.effect for u in free if not u.low <= instead.value(u.name) <= u.high]
    return tuple(beyond or (u.effect for u in free))


def _in_its_shape(model: Model, effect: str) -> Model:
    """The model where what an effect refines turns as sharply: its own shape is open in no fit."""
    plain = REFINES.get(effect)
    if plain is None or plain not in model.effects:
        return model
    strengths = {*find_effect(effect).strengths, *find_effect(plain).strengths}
    mine, its = (model.effects[name]._asdict() for name in (plain, effect))
    shape = {n: v for n, v in its.items() if n in mine and n not in strengths}
    return model.with_effect(plain, **{**mine, **shape})


def _let_go(unknown: Unknown) -> Unknown:
    """Free as far as a cause of its name may go."""
    prior = next(p.prior for p in find_effect(unknown.effect).parameters if p.name == unknown.field)
    low = max(min(WIDE * unknown.low, prior.low), prior.least) if unknown.low != 0.0 else 0.0
    high = min(max(WIDE * unknown.high, prior.high), prior.most)
    return replace(unknown, low=low, high=high, deviation=np.inf)
