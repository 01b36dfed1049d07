"""What a recording's beginning hardly tells, asked of all that was recorded.

slow     what warms, or turns but a few times; and what the beginning was not sure of
behind   what is small beside a load that coasts, where that is known
again    what was too little for a name: where a load coasts it may have stood in for that, or have
         been hidden by it
ratio    K_T over J, where both stand at opposite ends of what every rig may have
gap      where nothing else is wrong: one that is so by a little (`gap`)
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.searching.classes import class_of
from servo_bench.diagnosis.searching.coasting import OTHERWISE, is_coasting, with_coasting
from servo_bench.diagnosis.searching.contenders import REFINES, Contender, Round
from servo_bench.diagnosis.searching.gap import play_gap
from servo_bench.diagnosis.searching.gate import (
    FURTHER_GAIN,
    HELD_Z,
    LINES,
    RIGHT_ALREADY,
    material_sizes,
    misfit,
    passes,
    passes_slowly,
    promises,
    strength_of,
)
from servo_bench.diagnosis.searching.hypotheses import Hypothesis
from servo_bench.diagnosis.searching.joint import Named, fit_jointly, is_worth_it, own_unknowns
from servo_bench.diagnosis.searching.rounds import Told, play_round
from servo_bench.diagnosis.searching.scales import Scales
from servo_bench.diagnosis.searching.seeking import Found, seek
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
FAR_BELOW = 0.8
BEHIND = frozenset({"backlash_width", "encoder_subdivision"})
"""What is small beside a load that coasts, and asked once more where that is known."""


RATIO = ("torque_constant_error", "inertia_error")
AT_ITS_END = 0.95
"""Of its band, on which a nuisance is held back by nothing but that."""


class Late(NamedTuple):
    """What is asked of all that was recorded, and with what; `quick` is its beginning."""

    quick: Evidence
    whole: Evidence
    candidates: Sequence[Hypothesis]
    scales: Scales
    band: Sequence[Unknown]
    report: Told


def hidden_by_coasting(rounds: Sequence[Round], sizes: Mapping[str, float]) -> frozenset[str]:
    """What is asked again where a load coasts, after rounds without a cause: what took some of the
    error, though it was too small, or not beyond chance but for the part that was fitted.

    A line's size is known whatever the load does: where it is far below that of `sizes` it stays.
    """
    contenders = [c for played in rounds for c in played.contenders]
    some = [c for c in contenders if max(c.seen_gain, c.held_gain) > FURTHER_GAIN]
    small = {c.effect for c in some if c.effect in LINES and _is_far_below(c, sizes)}
    return frozenset({c.effect for c in some if c.seen_z > HELD_Z} - OTHERWISE - small)


def _is_far_below(one: Contender, sizes: Mapping[str, float]) -> bool:
    return abs(strength_of(one.found.model, one.effect)) < FAR_BELOW * sizes[one.effect]


def asked_again(
    late: Late, plain: Found, again: frozenset[str]
) -> tuple[Found, list[Named]] | None:
    """What was too little for a name, once more where the load coasts: without that it stood in for
    it, or was hidden by it. The joint fit with a cause, where that is better than neither."""
    coasting = with_coasting(late.whole, plain) if again else plain
    if not is_coasting(coasting.model):
        return None
    asked = [h for h in late.candidates if h.effect in again | BEHIND]
    right = float(misfit(late.whole, coasting.errors).max()) < RIGHT_ALREADY
    found = _play_late_round(late, coasting, asked, lambda one: passes(one, right=right))
    if found is None:
        return None
    joint, named = fit_jointly(late.whole, found.contender.found, [found], late.band, late.report)
    better = joint.errors.cost(plain.sigma) < plain.errors.cost(plain.sigma)
    return (joint, named) if better else None


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

    found = _play_late_round(late, final, asked, is_able)
    return found or (None if named else play_gap(late.whole, final, late.candidates, late.scales))


def held_back(final: Found) -> frozenset[str]:
    """K_T and J where their bands hold back what they are known by, K_T/J: both are at the end that
    makes it larger, or both at the one that makes it smaller."""
    pairs = zip(final.unknowns, final.values, strict=True)
    share = {u.effect: float(v) / u.high for u, v in pairs if u.effect in RATIO and u.high < np.inf}
    first, second = (share.get(effect, 0.0) for effect in RATIO)
    strained = first * second < 0.0 and min(abs(first), abs(second)) > AT_ITS_END
    return frozenset(RATIO) if strained else frozenset()


def unsure(failed: Sequence[Round]) -> frozenset[str]:
    """What rounds that ended without a cause were not sure of: it explains much of what no fit saw,
    and the beginning of the recording did not have enough of what shows it."""
    found = {c.effect for r in failed for c in r.contenders if promises(c)}
    return frozenset(found | {REFINES[effect] for effect in found & REFINES.keys()})


def _play_late_round(
    late: Late, final: Found, asked: Sequence[Hypothesis], able: Callable[[Contender], bool]
) -> Named | None:
    """The best of these that is `able` and worth a name, beside everything that was found."""
    if not asked:
        return None
    whole, sizes = late.whole, material_sizes(late.scales)
    base = seek(whole, final.model, final.unknowns, final.sigma, iterations=4, first=1)
    told = _in_late_effects(late.report)
    played = play_round(
        whole, base, asked, sizes, told, least=LEAST, settled=True, scouted=late.quick
    )
    names = [found.effect for found in played.contenders]
    for found in played.contenders:
        plain = REFINES.get(found.effect)
        if plain in names and names.index(plain) < names.index(found.effect):
            continue  # it is that, whether that is worth a name or not
        named = Named(found.effect, played, found, own_unknowns(found, found.effect))
        if able(found) and is_worth_it(named, found.found, late.scales):
            return named
    return None


def _in_late_effects(report: Told) -> Told:
    return lambda what: report(f"late effects: {what}")
