"""Two causes of which neither is beyond chance alone.

Who takes most of what was seen may do worse on what was held out, where something else is wrong as
well and shows more there: a K_T that droops at large currents took 88 % of what was seen and put
what was held out, which has none of these, up by 36 %; with friction that grows with the load
beside it 93 and 44 % went. So he is put into the base for one round. The two are causes where the
second is beyond chance beside him, and both together take most of what was seen.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.searching.classes import class_of
from servo_bench.diagnosis.searching.contenders import Contender, Round, faced
from servo_bench.diagnosis.searching.gate import A_FIFTH, HELD_Z, MOST_OF_IT, SEEN_Z, passes
from servo_bench.diagnosis.searching.hypotheses import SPRINGS, Hypothesis
from servo_bench.diagnosis.searching.rounds import Told, play_round


class Two(NamedTuple):
    """The first one, and the second with the round that it won beside the first."""

    first: Contender
    second: Contender
    played: Round


def in_two(
    quick: Evidence,
    alone: Round,
    asked: Sequence[Hypothesis],
    sizes: Mapping[str, float],
    told: Told,
) -> Two | None:
    """What a round that named nobody had, in two; a spring, which fits anything, is no half."""
    able = (c for c in alone.contenders if c.seen_gain > MOST_OF_IT and c.seen_z > SEEN_Z)
    first = next((c for c in able if c.effect not in SPRINGS), None)
    if first is None:
        return None
    others = [h for h in asked if h.effect not in class_of(first.effect)]
    played = play_round(quick, first.found, others, sizes, told)
    second = next((c for c in played.contenders if passes(c, named=1)), None)
    if second is None or second.effect in SPRINGS or not _take_most(quick, alone, second):
        return None
    return Two(first, second, played)


def _take_most(quick: Evidence, alone: Round, second: Contender) -> bool:
    """Whether both together take most of what was seen, and much of what was not."""
    both = faced(quick, alone.base, [(second.found, second.hypothesis)], sigma=alone.sigma)
    two = both.contenders[0]
    sure = two.seen_z > SEEN_Z and two.held_z > HELD_Z
    return sure and two.seen_gain > MOST_OF_IT and two.held_gain > A_FIFTH
