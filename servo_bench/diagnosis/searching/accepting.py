"""Round after round: who is accepted, and what is asked next.

accepted   the best that is beyond chance; the plain cause before what only refines it; what has a
           name before a coupling that has none
then       it is part of the base, and a load that coasts in its gap beside it; none of its class
           is asked any more
after a    round in which nothing held what it promised, what promised less has its turn, while the
           simulation is wrong by more than it may be; after the first, two at once (`in_two`)
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

from servo_bench.diagnosis.comparing.evidence import Evidence, block_z
from servo_bench.diagnosis.searching.classes import class_of
from servo_bench.diagnosis.searching.coasting import OTHERWISE, is_coasting, with_coasting
from servo_bench.diagnosis.searching.contenders import (
    BY_CHANCE,
    REFINES,
    Contender,
    Round,
)
from servo_bench.diagnosis.searching.gate import (
    GIVE,
    HELD_Z,
    MOST_CAUSES,
    RIGHT,
    RIGHT_ALREADY,
    misfit,
    passes,
    passes_slowly,
)
from servo_bench.diagnosis.searching.hypotheses import (
    ON_THE_LOAD,
    SPRINGS,
    VEHICLE,
    Hypothesis,
)
from servo_bench.diagnosis.searching.in_two import in_two
from servo_bench.diagnosis.searching.joint import (
    Named,
    is_worth_it,
    own_unknowns,
    worth_a_name,
)
from servo_bench.diagnosis.searching.rarely import acts_again
from servo_bench.diagnosis.searching.rounds import LEAST_GAIN, Told, play_round
from servo_bench.diagnosis.searching.scales import Scales
from servo_bench.diagnosis.searching.seeking import Found
from servo_bench.diagnosis.searching.sizes import material_sizes

MOST_ROUNDS = 6
TURNS = 3
"""After a round in which nothing held what it promised, what promised less has so many more, while
the simulation is wrong by more than it may be."""
FURTHER_PROMISE = 0.008
"""Screened gain below which a further cause is not even fitted where all is right already."""


def accepted_of(played: Round, named: int, *, right: bool) -> Contender | None:
    """The best that is beyond chance; or the plain cause before it, which it only refines, and
    which is so on all blocks together."""
    able = (c for c in played.contenders if passes(c, named=named, right=right))
    found = next(able, None)
    plain = next(iter(played.contenders), None)
    if found is not None and plain is not None and REFINES.get(found.effect) == plain.effect:
        return plain if passes_slowly(plain) else found
    return found


def with_a_name(
    accepted: Contender | None, played: Round, scales: Scales, able: Callable[[Contender], bool]
) -> Contender | None:
    """Who is accepted; in place of a coupling that takes little, or leads by chance alone, the best
    that is `able` and has a name.

    Every shaft gives way, and three free numbers of a spring fit a part of whatever is wrong: of a
    rig with a little more damping one took 4.9 % of what was seen and 19 of what was held out, the
    damping 4.9 and 8. Two couplings that were named before any load coasts took 36 % and more. Of
    five that were there each led the next by 4 standard deviations and more, one that a wrong
    inertia had brought about by 0.2.
    """
    if accepted is None or accepted.effect not in SPRINGS - {VEHICLE}:
        return accepted
    little = min(accepted.seen_gain, accepted.held_gain) <= GIVE
    others = (c for c in played.contenders if able(c))
    rivals = (
        c
        for c in others
        if c.effect not in SPRINGS and (little or block_z(accepted.costs, c.costs) < BY_CHANCE)
    )
    worth = (c for c in rivals if is_worth_it(_named(c, played), c.found, scales))
    return next(worth, accepted)


def _who_is(
    quick: Evidence, played: Round, named: int, scales: Scales, *, right: bool
) -> Contender | None:
    """Accepted, with a name where there is one."""
    accepted = accepted_of(played, named, right=right) or acts_again(quick, played)
    able = partial(passes, named=named, right=right)
    return with_a_name(accepted, played, scales, able)


def _hopeless(failed: Sequence[Round]) -> set[str]:
    """Who was beyond chance worse than nothing on what no fit saw: beside what is too small for a
    name it need not be asked once more."""
    return {c.effect for played in failed for c in played.contenders if c.held_z < -HELD_Z}


def _named(one: Contender, played: Round) -> Named:
    return Named(one.effect, played, one, own_unknowns(one, one.effect))


def _in_round(number: int, report: Told) -> Told:
    return lambda what: report(f"round {number}: {what}")


def _is_lower(one: Found, other: Found) -> bool:
    """Whether what a load that coasts brought about is better than neither."""
    return one.errors.cost(one.sigma) < other.errors.cost(one.sigma)


class Accepted(NamedTuple):
    """Base, causes, what is too small for a name, all rounds, those after the last cause, and who
    was accepted in the first."""

    now: Found
    named: list[Named]
    absorbed: list[str]
    rounds: list[Round]
    failed: list[Round]
    first: Contender | None


def one_way(
    quick: Evidence,
    base: Found,
    candidates: Sequence[Hypothesis],
    scales: Scales,
    report: Told,
    *,
    begun: tuple[Round, Contender] | None = None,
) -> Accepted:
    """One round after the other.

    Beside a cause, a load that coasts in its gap is put into the base of a round: a spring would
    stand in for it. What gives a load a motion of its own is asked without that, in a round after.

    `begun`: the first round, and who is accepted of it.
    """
    now, named, absorbed, rounds = base, list[Named](), list[str](), list[Round]()
    failed, turns, beside, first = list[Round](), list[set[str]](), base, None
    open_, sizes = list(candidates), material_sizes(scales)
    asked = open_
    for number in range(MOST_ROUNDS):
        if not asked or len(named) == MOST_CAUSES:
            break
        missed = float(misfit(quick, beside.errors).max())
        told = _in_round(number + 1, report)
        if begun is None:
            right = bool(named) and missed < RIGHT_ALREADY
            least = FURTHER_PROMISE if right else LEAST_GAIN
            played = play_round(quick, beside, asked, sizes, told, least=least)
            accepted = _who_is(quick, played, len(named), scales, right=right)
        else:
            (played, accepted), begun = begun, None
        rounds.append(played)
        failed.append(played)
        first, two = (accepted if number == 0 else first), None
        if accepted is None and not (named or absorbed or turns) and missed > RIGHT:
            two = in_two(quick, played, asked, sizes, told)
        if two is not None:
            rounds.append(two.played)
            named += [_named(two.first, played), _named(two.second, two.played)]
            now, turns, failed = two.second.found, [], []
            beside = with_coasting(quick, now)
            taken = class_of(two.first.effect) | class_of(two.second.effect)
            open_ = asked = [h for h in open_ if h.effect not in taken]
        elif accepted is not None and (beside is now or _is_lower(accepted.found, now)):
            one = _named(accepted, played)
            worth = worth_a_name(one, accepted.found, scales)
            named += worth
            absorbed += [] if one in worth else [one.effect]
            hopeless = set[str]() if worth else _hopeless(failed)
            now, turns, failed = accepted.found, [hopeless] if hopeless else [], []
            beside = with_coasting(quick, now) if named else now
            # of a class one is enough: two would share among them what nobody can tell apart
            open_ = [h for h in open_ if h.effect not in class_of(accepted.effect)]
            out = OTHERWISE if is_coasting(beside.model) else frozenset[str]()
            asked = [h for h in open_ if h.effect not in out.union(*turns)]
        elif beside is not now:
            beside, asked = now, [h for h in open_ if h.effect in ON_THE_LOAD]
        elif missed < RIGHT or not played.contenders or len(turns) == TURNS:
            break
        else:
            turns.append({c.effect for c in played.contenders})
            asked = [h for h in asked if h.effect not in turns[-1]]
    return Accepted(now, named, absorbed, rounds, failed, first)
