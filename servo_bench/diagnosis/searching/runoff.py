"""Causes that the recording's beginning could not tell apart, once more: on all that was recorded.

A round is played on the beginning, because fits there are cheap. What it leaves between a cause and
its near rivals is noise of a few seconds; on everything they often lie ten deviations apart.

Friction faces the plain one that it refines however far that lay behind: 14 mN m that a round
called friction that warms, beside an offset and an asymmetry yet to be found, was plain.

A coupling that was found while the load stood in its gap faces whoever was sure in its round, once
it coasts: three free numbers fit a part of what that does. Of a lag of 0.26 ms one took 32 % where
the lag took 25.

Bristles that came to slide beside what was found after them face what slides: a round found 1.5
mrad of them while they stood in for a load's friction too, and the joint fit 2 urad.
"""

from collections.abc import Collection, Sequence
from contextlib import suppress

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.searching.classes import class_of, siblings_of
from servo_bench.diagnosis.searching.coasting import OTHERWISE, is_coasting
from servo_bench.diagnosis.searching.contenders import REFINES, SLIDING_RAD, Contender, faced
from servo_bench.diagnosis.searching.gate import is_sure, strength_of, together
from servo_bench.diagnosis.searching.hypotheses import SPRINGS, VEHICLE, Hypothesis
from servo_bench.diagnosis.searching.joint import Named, fit_jointly, own_unknowns, worth_a_name
from servo_bench.diagnosis.searching.late import Late
from servo_bench.diagnosis.searching.rounds import Told
from servo_bench.diagnosis.searching.seeking import Found, seek, settle
from servo_bench.diagnosis.searching.unknowns import Unknown, merged, widened
from servo_bench.errors import FitError
from sim_rig.effects import find_effect
from sim_rig.errors import SimRigError
from sim_rig.model import Model

COUPLING = SPRINGS - {VEHICLE}
HARDLY_SURE = 8.0
"""Beyond chance, seen and held out together, on a recording's beginning: uneven friction stood at
4.2 and 4.7 there, four ahead of the next."""


def run_off(
    whole: Evidence,
    final: Found,
    named: Sequence[Named],
    band: Sequence[Unknown],
    report: Told,
    *,
    coasts: bool = False,
) -> tuple[Found, list[Named]]:
    """The joint fit with the better of every cause and its near rivals; each with a round of all
    that was recorded where it had any. A rival that takes a cause's place is fitted jointly anew.

    Where it `coasts` since a coupling was found, that one faces all that were sure.
    """
    kept, now = list(named), final
    brought = {n.effect: brought_by(n, n.contender) for n in named}
    for place, one in enumerate(named):
        others = frozenset().union(*(brought[n.effect] for n in named if n is not one))
        rivals = _near_ones(one, kept) if not coasts else _sure_ones(one, kept)
        slides = None if coasts else _sliding(one, kept, now)
        if not rivals and slides is None:
            continue
        facing = (*rivals, *((slides,) if slides else ()))
        against = ", ".join(dict.fromkeys(rival.effect for rival in facing))
        report(f"{one.effect} against {against}")
        gone = brought[one.effect] - others
        ends = [(sought_again(whole, now, gone), one.contender.hypothesis)]
        if slides is not None:
            with suppress(FitError, SimRigError, np.linalg.LinAlgError):
                ends.append((_slid(whole, now, one.effect, slides), slides))
        for rival in rivals:
            try:
                new = brought_by(one, rival) - others
                ends.append(
                    (sought_instead(whole, now, gone, (rival, new), band), rival.hypothesis)
                )
            except (FitError, SimRigError, np.linalg.LinAlgError):
                continue
        if len(ends) == 1:
            continue
        try:
            base = sought_without(whole, now, {one.effect, *(gone - SPRINGS)}, band)
        except SimRigError:  # the others need it
            continue
        played = faced(whole, base, ends, one.round.screened)
        first = played.contenders[0]
        kept[place] = Named(first.effect, played, first, own_unknowns(first, first.effect))
        if first.effect != one.effect:
            now = first.found
    return (final, kept) if now is final else fit_jointly(whole, now, kept, band, report)


def couplings_again(
    late: Late, final: Found, named: Sequence[Named]
) -> tuple[Found, list[Named], list[str]]:
    """The joint fit, its causes, and what is too small for a name, once the load coasts: a coupling
    that was found before faces its rivals. Who faced others has to be worth its name there; where
    the rig's file has one already, nobody knows what a rig without it does.
    """
    if not is_coasting(final.model) or COUPLING & dict(late.scales.believed).keys():
        return final, list(named), []
    before = {n.effect: n.round for n in named}
    final, faced = run_off(late.whole, final, named, late.band, late.report, coasts=True)
    worth = {
        n.effect: (n,) if before.get(n.effect) is n.round else worth_a_name(n, final, late.scales)
        for n in faced
    }
    small = [effect for effect, names in worth.items() if not names]
    return final, [n for names in worth.values() for n in names], small


def brought_by(one: Named, contender: Contender) -> frozenset[str]:
    """What came with a contender of a cause's round: what carries it, and what it carries."""
    usual = {u.effect for u in one.round.base.unknowns}
    mine = {u.effect for u in contender.found.unknowns} - usual | {contender.effect}
    own = [u for u in contender.found.unknowns if u.effect in mine]
    return frozenset(mine | {name.split(".")[0] for u in own for name in u.carried})


def _near_ones(one: Named, named: Sequence[Named]) -> list[Contender]:
    """Near ones that could be told from the cause, or from it where the shaft rests, and the plain
    friction that it refines, none of them named themselves; all that gained, but for couplings,
    where the beginning was hardly sure of the cause itself."""
    near = {c.effect for c in one.round.near(one.contender)} | siblings_of(one.effect)
    near.add(REFINES.get(one.effect, ""))
    if together(one.contender) < HARDLY_SURE:
        near |= {c.effect for c in one.round.contenders if c.effect not in COUPLING and _gains(c)}
    return _rivals(one, named, near)


def _sure_ones(one: Named, named: Sequence[Named]) -> list[Contender]:
    """Of a coupling that was found while the load stood, all that were sure beside it, and give the
    load no motion of its own."""
    if one.effect not in COUPLING or is_coasting(one.round.base.model):
        return []
    sure = {c.effect for c in one.round.contenders if is_sure(c)}
    return _rivals(one, named, sure - OTHERWISE)


def _gains(contender: Contender) -> bool:
    return contender.held_gain > 0.0


def _rivals(one: Named, named: Sequence[Named], asked: Collection[str]) -> list[Contender]:
    if one.missed_z is not None or one.effect != one.contender.effect:
        return []
    out = frozenset().union(*(class_of(n.effect) for n in named)) - siblings_of(one.effect)
    out |= {n.effect for n in named}
    return [c for c in one.round.contenders if c.effect in frozenset(asked) - out]


def _sliding(one: Named, named: Sequence[Named], now: Found) -> Hypothesis | None:
    """The plain friction that bristles are which slide in the joint fit, where that was asked and
    is no cause beside them."""
    plain = REFINES.get(one.effect, "")
    angle_rad = getattr(now.model.effects.get(one.effect), "breakaway_angle_rad", np.inf)
    if angle_rad > SLIDING_RAD or any(n.effect == plain for n in named):
        return None
    return next((s.hypothesis for s in one.round.screened if s.hypothesis.effect == plain), None)


def _slid(whole: Evidence, now: Found, bristles: str, slides: Hypothesis) -> Found:
    """The joint fit with plain friction that is as strong, and turns as sharply as it is tried."""
    plain = slides.effect
    size = strength_of(now.model, bristles) + strength_of(now.model, plain)
    sharp = min(t.settings["transition_rad_s"] for t in slides.trials)
    strength = find_effect(plain).strengths[0]
    table = {strength: size, "transition_rad_s": sharp}
    model = now.model.without(bristles).with_effect(plain, **table)
    own = widened(plain, slides.free, model, size)
    rest = [u for u in now.unknowns if u.effect not in {bristles, plain}]
    return sought_again(whole, put(now, model, [*rest, *own]), {plain})


def sought_again(whole: Evidence, found: Found, own: Collection[str]) -> Found:
    """As much search for everyone."""
    again = seek(whole, found.model, found.unknowns, found.sigma, iterations=4, first=1)
    return settle(whole, again, own, turns=1)


def sought_instead(
    whole: Evidence,
    now: Found,
    gone: Collection[str],
    instead: tuple[Contender, Collection[str]],
    band: Sequence[Unknown],
) -> Found:
    """The joint fit with a rival, and all that came with it, in the place of what is gone."""
    rival, new = instead
    start = taken_out(now, {*gone, *new}, set(gone) - set(new), band)
    model = start.model
    for effect in new:
        model = model.with_effect(effect, **rival.found.model.effects[effect]._asdict())
    unknowns = merged(start.unknowns, [u for u in rival.found.unknowns if u.effect in new])
    return sought_again(whole, put(start, model, unknowns), new)


def sought_without(
    whole: Evidence, now: Found, gone: Collection[str], band: Sequence[Unknown]
) -> Found:
    return sought_again(whole, taken_out(now, gone, gone, band), ())


def taken_out(
    now: Found, gone: Collection[str], back: Collection[str], band: Sequence[Unknown]
) -> Found:
    """A search's start without some effects; those of `back` that every rig has, in their bands."""
    model, usual = now.model.without(*gone), [u for u in band if u.effect in back]
    for unknown in usual:
        value = np.clip(unknown.of(now.model), unknown.low, unknown.high)
        model = unknown.put(model, float(value))
    return put(now, model, [*(u for u in now.unknowns if u.effect not in gone), *usual])


def put(now: Found, model: Model, unknowns: Sequence[Unknown]) -> Found:
    """Another start; what is carried comes first."""
    return now._replace(
        model=model, unknowns=tuple(sorted(unknowns, key=lambda u: bool(u.carries)))
    )
