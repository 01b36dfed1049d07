"""A law that refines Coulomb friction, and whether what it adds is seen.

Bristles that give next to nothing are Coulomb friction, and so is friction that warms in a record
much shorter than that takes: the law does all that plain friction does, and says something more
that nothing shows. Where plain friction is a rival, that decides. Where it is none, as it was not
asked or promised too little, the law faces itself without what it adds.
"""

from collections.abc import Collection, Sequence

from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.searching.contenders import REFINES, SLIDING_RAD, all_costs
from servo_bench.diagnosis.searching.seeking import Found, seek

BRISTLES, WARMING = "pre_sliding", "thermal_friction"
PLAIN = REFINES[BRISTLES]
STEADY_S = 1e9
OVER_PLAIN = 0.2
"""Of what friction that warms takes, how much more it must be than what plain friction takes that
was asked beside it: of one that stood in for a wrong inertia's damping it was 0.12, eight standard
deviations. True ones are beside the friction that they warm from, which has its name by then."""


def must_show_itself(asked: Collection[str], contend: Sequence[str]) -> bool:
    """Whether a law that refines plain friction must show what it adds: where that is no rival. One
    that is alone, and plain friction not asked, is told as what stands in for it (`doubts`)."""
    return PLAIN not in contend and (PLAIN in asked or len(contend) > 1)


def shows_itself(evidence: Evidence, base: Found, found: Found, effect: str) -> bool:
    """Whether a search beside `base` found bristles that do more than slide, or friction that is
    seen to warm; of any other effect, yes."""
    if effect == BRISTLES:
        return float(found.model.effects[BRISTLES].breakaway_angle_rad) >= SLIDING_RAD
    return effect != WARMING or is_seen_to_warm(evidence, base, found)


def is_seen_to_warm(evidence: Evidence, base: Found, warm: Found) -> bool:
    """Whether friction that warms takes so much more of the base's cost, seen and held out, than
    the same friction that does not."""
    numbers = {**warm.model.effects[WARMING]._asdict(), "warming_s": STEADY_S}
    start = warm.model.with_effect(WARMING, **numbers)
    steady = seek(evidence, start, warm.unknowns, warm.sigma, iterations=3, first=1)
    ends = (base, warm, steady)
    held = evidence.held_out([end.model for end in ends])
    without, with_it, plain = (
        float(all_costs(end.errors, h, warm.sigma).sum()) for end, h in zip(ends, held, strict=True)
    )
    return plain - with_it > OVER_PLAIN * (without - with_it)
