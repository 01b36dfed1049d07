"""Causes that the recording's beginning could not tell apart, once more: on all that was recorded.

A round is played on the beginning, because fits there are cheap. What it leaves between a cause and
its near rivals is noise of a few seconds; on everything they often lie ten deviations apart.
"""

from collections.abc import Sequence

import numpy as np

from servo_bench.diagnosis.classes import class_of
from servo_bench.diagnosis.evidence import Evidence
from servo_bench.diagnosis.joint import Named, own_unknowns, without_effect
from servo_bench.diagnosis.rounds import Contender, Told, faced, merged
from servo_bench.diagnosis.seeking import Found, seek, settle
from servo_bench.diagnosis.unknowns import Unknown
from servo_bench.errors import FitError
from sim_rig.errors import SimRigError


def run_off(
    whole: Evidence, final: Found, named: Sequence[Named], band: Sequence[Unknown], report: Told
) -> tuple[Found, list[Named]]:
    """The joint fit with the better of every cause and its near rivals; each with a round of all
    that was recorded where it had any."""
    kept = list(named)
    for place, one in enumerate(named):
        others = [n for n in kept if n is not one]
        rivals = _rivals(one, others)
        if not rivals:
            continue
        report(f"{one.effect} against {', '.join(rival.effect for rival in rivals)}")
        ends = [(one.contender, _again(whole, final, {one.effect}))]
        for rival in rivals:
            try:
                ends.append((rival, _instead(whole, final, (one, rival), others, band)))
            except (FitError, SimRigError):
                continue
        base = without_effect(whole, final, one.effect, band, iterations=3)
        against = [(end, contender.hypothesis) for contender, end in ends]
        played = faced(whole, base, against, one.round.screened)
        first = played.contenders[0]
        kept[place] = Named(first.effect, played, first, own_unknowns(first, first.effect))
        final = first.found
    return final, kept


def _rivals(one: Named, others: Sequence[Named]) -> list[Contender]:
    """Near ones that could be told from the cause, and are not named themselves."""
    if one.missed_z is not None:
        return []
    out = class_of(one.effect).union(*(class_of(n.effect) for n in others))
    return [c for c in one.round.near(one.contender) if c.effect not in out]


def _again(whole: Evidence, found: Found, own: set[str]) -> Found:
    """As much search for everyone."""
    again = seek(whole, found.model, found.unknowns, found.sigma, iterations=4, first=1)
    return settle(whole, again, own, turns=1)


def _instead(
    whole: Evidence,
    final: Found,
    pair: tuple[Named, Contender],
    others: Sequence[Named],
    band: Sequence[Unknown],
) -> Found:
    """The joint fit with a rival, and what carries it, in a cause's place."""
    one, rival = pair
    usual = {u.effect for u in one.round.base.unknowns}
    usual |= {u.effect for n in others for u in n.contender.found.unknowns}
    brought = {u.effect for u in rival.found.unknowns} - usual | {rival.effect}
    gone = {u.effect for u in one.contender.found.unknowns} - usual | {one.effect}
    model = final.model.without(*gone)
    for effect in brought:
        model = model.with_effect(effect, **rival.found.model.effects[effect]._asdict())
    back = tuple(u for u in band if u.effect in gone - brought)
    for unknown in back:
        value = np.clip(unknown.of(rival.found.model), unknown.low, unknown.high)
        model = unknown.put(model, float(value))
    stayed = tuple(u for u in final.unknowns if u.effect not in gone | brought)
    new = tuple(u for u in rival.found.unknowns if u.effect in brought)
    start = final._replace(model=model, unknowns=merged(stayed, (*back, *new)))
    return _again(whole, start, brought)
