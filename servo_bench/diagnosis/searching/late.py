"""What a recording's beginning hardly tells, asked of all that was recorded.

slow     what warms, or turns but a few times; and what the beginning was not sure of
behind   what is small beside a load that coasts, where that is known
again    all, where a load coasts and nothing was named: it hides what is small, and what was too
         little for a name may have stood in for it
ratio    K_T over J, where both stand at opposite ends of what every rig may have
gap      where nothing else is wrong: one that is so by a little (`gap`)
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.searching.accepting import with_a_name
from servo_bench.diagnosis.searching.classes import class_of
from servo_bench.diagnosis.searching.coasting import OTHERWISE, is_coasting, with_coasting
from servo_bench.diagnosis.searching.contenders import REFINES, Contender, Round, faced
from servo_bench.diagnosis.searching.gap import play_gap
from servo_bench.diagnosis.searching.gate import (
    LINES,
    MUCH,
    RIGHT_ALREADY,
    is_sure,
    misfit,
    passes_beside_coasting,
    passes_slowly,
    promises,
    strength_of,
)
from servo_bench.diagnosis.searching.hypotheses import SPRINGS, Hypothesis
from servo_bench.diagnosis.searching.joint import Named, fit_jointly, is_worth_it, own_unknowns
from servo_bench.diagnosis.searching.letting_go import AT_ITS_END
from servo_bench.diagnosis.searching.rarely import acts_again
from servo_bench.diagnosis.searching.refining import OVER_PLAIN
from servo_bench.diagnosis.searching.rounds import Told, play_round
from servo_bench.diagnosis.searching.scales import Scales
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.sizes import material_sizes
from servo_bench.diagnosis.searching.unknowns import Unknown

LEAST = 3e-4
"""Screened gain below which nothing is fitted: of what is slow a record shows but a part."""
SLOW = frozenset(
    {
        *("thermal_friction", "thermal_torque_constant", "clock_skew"),
        *("encoder_eccentricity", "misalignment", "position_backlash"),
    }
)
"""What a recording's beginning hardly shows, because it warms slowly or turns but a few times:
asked once more of all that was recorded."""
BEHIND = frozenset({"backlash_width", "encoder_subdivision"})
"""What is small beside a load that coasts, and asked once more where that is known."""
FAR_BELOW = 0.8
MOST_TURNS, PROMISED, SPRINGS_PROMISED = 3, 0.004, 0.02
"""Of asking what a load that coasts has hidden: beside what was found, or is too small for a name,
once more; and the screened gain below which nothing is fitted there, and no spring."""

RATIO = ("torque_constant_error", "inertia_error")


class Late(NamedTuple):
    """What is asked of all that was recorded, and with what; `quick` is its beginning."""

    quick: Evidence
    whole: Evidence
    candidates: Sequence[Hypothesis]
    scales: Scales
    band: Sequence[Unknown]
    report: Told


def asked_again(
    late: Late, longer: Evidence, plain: Found, final: Found, report: Callable[[Round], None]
) -> tuple[Found, list[Named]] | None:
    """What no round found, once more where the load coasts: without that it stood in for it, or was
    hidden by it. The joint fit with one cause or several, where that is better than none.

    What is too small for a name, a line of the shaft that `final` has first, is part of the base.
    It is asked of `longer`, not of the whole: a load that coasts takes long to play.
    """
    asking = late._replace(whole=longer)
    beside = with_coasting(longer, _with_small_lines(asking, plain, final))
    if not is_coasting(beside.model):
        return None
    out = OTHERWISE | (LINES & beside.model.effects.keys())
    asked = [h for h in late.candidates if h.effect not in out]
    kept: list[Named] = []
    for _ in range(MOST_TURNS):
        if not asked:
            break
        right = float(misfit(longer, beside.errors).max()) < RIGHT_ALREADY
        played = _late_round(
            *(asking, beside, asked),
            least=PROMISED,
            least_of_springs=SPRINGS_PROMISED,
            however_small=LINES,
        )
        report(played)
        able = partial(passes_beside_coasting, right=right)
        found = next((c for c in no_plainer(played) if able(c)), None)
        found = with_a_name(found, played, late.scales, able)
        if found is None:
            rare = None if kept else _acts_again(late, played)
            return _jointly(late, plain, [rare] if rare is not None else kept)
        named = Named(found.effect, played, found, own_unknowns(found, found.effect))
        if is_worth_it(named, found.found, late.scales):
            kept.append(named)
        beside = found.found
        hopeful = {s.hypothesis.effect for s in played.screened if s.gain > LEAST}
        springs = SPRINGS & {c.effect for c in played.contenders}  # three free numbers: asked once
        asked = [h for h in asked if h.effect in hopeful - class_of(found.effect) - springs]
    return _jointly(late, plain, kept)


def _acts_again(late: Late, played: Round) -> Named | None:
    """A round's best one, where it took much of what was seen and acts rarely, fitted on as little
    as leaves some of the identification to judge it."""
    quick = late.quick
    first = next((c for c in played.contenders if c.seen_gain > MUCH), None)
    if first is None:
        return None
    found = seek(quick, first.found.model, first.found.unknowns, iterations=2, first=1)
    base = seek(quick, played.base.model, played.base.unknowns, iterations=2, first=1)
    again = faced(quick, base, [(found, first.hypothesis)], played.screened)
    acts = acts_again(quick, again)
    if acts is None:
        return None
    named = Named(acts.effect, again, acts, own_unknowns(acts, acts.effect))
    return named if is_worth_it(named, acts.found, late.scales) else None


def _with_small_lines(late: Late, plain: Found, final: Found) -> Found:
    """The plain fit on what is asked, with the lines that another one has beside it which are far
    too small for a name: that is known whatever the load does."""
    sizes = material_sizes(late.scales)
    here = LINES & final.model.effects.keys()
    small = {e for e in here if abs(strength_of(final.model, e)) < FAR_BELOW * sizes[e]}
    effects = {**plain.model.effects, **{e: final.model.effects[e] for e in small}}
    own = tuple(u for u in final.unknowns if u.effect in small)
    model, unknowns = replace(plain.model, effects=effects), (*plain.unknowns, *own)
    return seek(late.whole, model, unknowns, plain.sigma, iterations=1, first=2)


def _jointly(late: Late, plain: Found, named: Sequence[Named]) -> tuple[Found, list[Named]] | None:
    """The joint fit with these, where there are any and that is better than the plain one."""
    if not named:
        return None
    now = named[-1].contender.found
    joint, kept = fit_jointly(late.whole, now, list(named), late.band, late.report)
    better = joint.errors.cost(plain.sigma) < plain.errors.cost(plain.sigma)
    return (joint, kept) if better else None


def asked_late(
    late: Late, final: Found, named: Sequence[Named], open_: frozenset[str]
) -> Named | None:
    """A cause that only all of the recording shows: a slow one, one that the beginning could not be
    sure of, a ratio that its bands hold back, or where nothing else is wrong a gap that is so by a
    little. It comes beside as many as there are: one that stood in for it is not needed then."""
    slow = SLOW | BEHIND if is_coasting(final.model) else SLOW
    unsure_of = open_ - slow - (OTHERWISE if is_coasting(final.model) else frozenset())
    out = frozenset().union(*(class_of(n.effect) for n in named))
    rivals = frozenset(REFINES[effect] for effect in slow & REFINES.keys()) - unsure_of
    strained = frozenset[str]() if named else held_back(final)  # beside a cause, by a wrong one
    asked = [h for h in late.candidates if h.effect in (slow | rivals | unsure_of | strained) - out]

    def is_able(one: Contender) -> bool:
        """What was asked before, of as much as shows it, is a rival here and no more."""
        unsure_still = one.effect in unsure_of - strained and not promises(one)
        known = one.effect in rivals or unsure_still
        return passes_slowly(one) and not known

    gap = None if named else play_gap(late.whole, final, late.candidates, late.scales)
    return gap or _play_late_round(late, final, asked, is_able)


def held_back(final: Found) -> frozenset[str]:
    """K_T and J where their bands hold back what they are known by, K_T/J: both are at the end that
    makes it larger, or both at the one that makes it smaller."""
    pairs = zip(final.unknowns, final.values, strict=True)
    share = {u.effect: _of_band(u, float(v)) for u, v in pairs if u.effect in RATIO}
    first, second = (share.get(effect, 0.0) for effect in RATIO)
    strained = first * second < 0.0 and min(abs(first), abs(second)) > AT_ITS_END
    return frozenset(RATIO) if strained else frozenset()


def _of_band(unknown: Unknown, value: float) -> float:
    """Where in its band a number stands, -1 to 1; 0 where it has none."""
    middle = 0.5 * (unknown.low + unknown.high)
    return (value - middle) / (unknown.high - middle) if np.isfinite(unknown.deviation) else 0.0


def unsure(failed: Sequence[Round]) -> frozenset[str]:
    """What rounds that ended without a cause were not sure of: it explains much of what no fit saw,
    and the beginning of the recording did not have enough of what shows it."""
    found = {c.effect for r in failed for c in r.contenders if promises(c)}
    return frozenset(found | {REFINES[effect] for effect in found & REFINES.keys()})


def _play_late_round(
    late: Late, final: Found, asked: Sequence[Hypothesis], able: Callable[[Contender], bool]
) -> Named | None:
    """The best of these that is `able` and worth a name, beside everything that was found; who is
    sure before who only grows."""
    if not asked:
        return None
    played = _late_round(late, final, asked)
    for found in sorted(no_plainer(played), key=lambda c: not is_sure(c)):
        named = Named(found.effect, played, found, own_unknowns(found, found.effect))
        if able(found) and is_worth_it(named, found.found, late.scales):
            return named
    return None


def no_plainer(played: Round) -> list[Contender]:
    """The contenders, without a refinement of what is better than it, or takes nearly as much where
    it warms: it is that, whether that is worth a name or not."""
    names = [one.effect for one in played.contenders]
    plainer = {one: names.index(REFINES[one]) for one in names if REFINES.get(one) in names}
    return [
        c
        for k, c in enumerate(played.contenders)
        if plainer.get(c.effect, k) >= k and not _is_nearly_plain(played, c)
    ]


def _is_nearly_plain(played: Round, one: Contender) -> bool:
    """Whether the plain friction alone takes nearly all that one which warms does."""
    plain = next((c for c in played.contenders if REFINES.get(one.effect) == c.effect), None)
    if plain is None or one.effect not in SLOW:
        return False
    base = float(played.base_costs.sum())
    return plain.total - one.total < OVER_PLAIN * (base - one.total)


def _late_round(
    late: Late,
    final: Found,
    asked: Sequence[Hypothesis],
    *,
    least: float = LEAST,
    least_of_springs: float = 0.0,
    however_small: frozenset[str] = frozenset(),
) -> Round:
    """Asked of everything in `late.whole`; some are fitted `however_small`."""
    whole, sizes = late.whole, material_sizes(late.scales)
    sizes = {effect: size for effect, size in sizes.items() if effect not in however_small}
    base = seek(whole, final.model, final.unknowns, final.sigma, iterations=4, first=1)
    told = _in_late_effects(late.report)
    return play_round(
        *(whole, base, asked, sizes, told),
        least=least,
        least_of_springs=least_of_springs,
        settled=True,
        scouted=late.quick,
    )


def _in_late_effects(report: Told) -> Told:
    return lambda what: report(f"late effects: {what}")
