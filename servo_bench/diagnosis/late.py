"""What a recording's beginning hardly tells, asked of all that was recorded.

slow     what warms, or turns but a few times; and what the beginning was not sure of
behind   what is small beside a load that coasts, where that is known
again    what was too little for a name: where a load coasts it may have stood in for that, or have
         been hidden by it
gap      where nothing else is wrong: one that is so by a little (`gap`)
"""

from collections.abc import Callable, Sequence

from servo_bench.diagnosis.classes import class_of
from servo_bench.diagnosis.coasting import OTHERWISE, is_coasting, with_coasting
from servo_bench.diagnosis.evidence import Evidence
from servo_bench.diagnosis.gap import play_gap
from servo_bench.diagnosis.gate import (
    MOST_CAUSES,
    material_sizes,
    passes,
    passes_slowly,
    promises,
)
from servo_bench.diagnosis.hypotheses import Hypothesis, Scales
from servo_bench.diagnosis.joint import Named, is_worth_it, own_unknowns
from servo_bench.diagnosis.rounds import REFINES, Contender, Round, Told, play_round
from servo_bench.diagnosis.seeking import Found, seek

SLOW_GAIN = 3e-4
"""Screened gain below which nothing slow is fitted: a record shows but a part of what it does."""
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


def asked_again(
    whole: Evidence,
    plain: Found,
    absorbed: Sequence[str],
    candidates: Sequence[Hypothesis],
    scales: Scales,
    *,
    report: Told,
) -> Named | None:
    """What was too little for a name, once more where the load coasts: without that it stood in for
    it, or was hidden by it."""
    coasting = with_coasting(whole, plain)
    if not is_coasting(coasting.model):
        return None
    again = [h for h in candidates if h.effect in absorbed and h.effect not in OTHERWISE]
    return _play_late_round(whole, coasting, again, scales, able=passes, report=report)


def asked_late(
    whole: Evidence,
    final: Found,
    known: tuple[Sequence[Named], frozenset[str]],
    candidates: Sequence[Hypothesis],
    scales: Scales,
    *,
    report: Told,
) -> Named | None:
    """A cause that only all of the recording shows: a slow one, one that the beginning could not be
    sure of, or where nothing else is wrong a gap that is so by a little."""
    named, open_ = known
    if len(named) == MOST_CAUSES:
        return None
    slow = SLOW | BEHIND if is_coasting(final.model) else SLOW
    open_ -= slow | (OTHERWISE if is_coasting(final.model) else frozenset())
    out = frozenset().union(*(class_of(n.effect) for n in named))
    late = [h for h in candidates if h.effect in (slow | open_) - out]

    def is_able(one: Contender) -> bool:
        return passes_slowly(one) and (one.effect not in open_ or promises(one))

    found = _play_late_round(whole, final, late, scales, able=is_able, report=report)
    return found or (None if named else play_gap(whole, final, candidates, scales))


def unsure(failed: Sequence[Round]) -> frozenset[str]:
    """What rounds that ended without a cause were not sure of: it explains much of what no fit saw,
    and the beginning of the recording did not have enough of what shows it."""
    found = {c.effect for r in failed for c in r.contenders if promises(c)}
    return frozenset(found | {REFINES[effect] for effect in found & REFINES.keys()})


def _play_late_round(
    whole: Evidence,
    final: Found,
    late: Sequence[Hypothesis],
    scales: Scales,
    *,
    able: Callable[[Contender], bool],
    report: Told,
) -> Named | None:
    """The best of these that is `able` and worth a name, beside everything that was found."""
    if not late:
        return None
    base = seek(whole, final.model, final.unknowns, final.sigma, iterations=1, first=3)
    sizes = material_sizes(scales)
    played = play_round(
        whole, base, late, sizes, lambda what: report(f"late effects: {what}"), least=SLOW_GAIN
    )
    for found in played.contenders:
        named = Named(found.effect, played, found, own_unknowns(found, found.effect))
        if able(found) and is_worth_it(named, found.found, scales):
            return named
    return None
