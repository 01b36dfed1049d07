"""A gap that is a little wrong: within the band that every rig has, and yet most of what is wrong.

A gap measured with a gauge is right to a few percent, so its band is free in every fit, and a cause
is what leaves it. Once all else is known, a load that coasts among it, the recording knows the gap
far better than any gauge: then the gap of the drawing competes with the one that was found.
"""

from collections.abc import Sequence

from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.searching.contenders import faced
from servo_bench.diagnosis.searching.gate import A_FIFTH, beyond_belief, passes
from servo_bench.diagnosis.searching.hypotheses import Hypothesis
from servo_bench.diagnosis.searching.joint import Named, is_worth_it, own_unknowns
from servo_bench.diagnosis.searching.scales import Scales, as_believed
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.sizes import material_sizes
from servo_bench.diagnosis.searching.unknowns import widened

GAP, FREE = "backlash_width", ("change_rad",)
THIRD = 0.35
"""Of the size that is worth a name whatever it explains: where most of the error is the gap's, a
third of it is."""


def play_gap(
    whole: Evidence, final: Found, candidates: Sequence[Hypothesis], scales: Scales
) -> Named | None:
    """The gap as a cause, where that of the drawing leaves a fifth more of the error."""
    hypothesis = next((h for h in candidates if h.effect == GAP), None)
    least_rad = THIRD * material_sizes(scales)[GAP]
    if hypothesis is None or beyond_belief(final.model, GAP, scales) < least_rad:
        return None
    others = tuple(u for u in final.unknowns if u.effect != GAP)
    drawn = as_believed(final.model, GAP, scales)
    base = seek(whole, drawn, others, final.sigma, iterations=4)
    own = widened(GAP, FREE, final.model, least_rad)
    found = seek(whole, final.model, (*others, *own), final.sigma, iterations=2, first=2)
    played = faced(whole, base, [(found, hypothesis)])
    contender = played.contenders[0]
    named = Named(GAP, played, contender, own_unknowns(contender, GAP))
    enough = contender.held_gain > A_FIFTH and passes(contender)
    return named if enough and is_worth_it(named, found, scales) else None
