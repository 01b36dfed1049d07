"""A cause and rivals that change something else: not one or the other, but one, or both.

Two hypotheses that take as much of the cost each are rivals where they change the same. A dead time
that changes the motor's way at low speed and a coupling that stood in for a load's motion in its
gap do not: that they were as good says nothing of either. What does is whether the cause is missed
where the rival is there too, beside everything that was found since.

It has to be missed beside every rival that was as good, by so much as is worth a name there; and
where one of them changes the same, which is which is a matter of one or the other.
"""

from collections.abc import Collection, Sequence
from contextlib import suppress

import numpy as np

from servo_bench.diagnosis.comparing.evidence import block_z
from servo_bench.diagnosis.searching.classes import class_of
from servo_bench.diagnosis.searching.coasting import is_coasting
from servo_bench.diagnosis.searching.contenders import (
    BY_CHANCE,
    LIKE,
    RIVAL_Z,
    Contender,
    faced,
)
from servo_bench.diagnosis.searching.gate import HELD_Z, is_sure, together
from servo_bench.diagnosis.searching.hypotheses import SPRINGS, VEHICLE
from servo_bench.diagnosis.searching.joint import (
    NEEDED_SHARE,
    Named,
    is_worth_it,
    own_unknowns,
)
from servo_bench.diagnosis.searching.late import Late
from servo_bench.diagnosis.searching.runoff import (
    brought_by,
    put,
    sought_again,
    sought_instead,
    sought_without,
)
from servo_bench.diagnosis.searching.seeking import Found
from servo_bench.diagnosis.searching.unknowns import merged
from servo_bench.errors import FitError
from sim_rig.errors import SimRigError

CLEARLY_Z, MOST = 2.0 * HELD_Z, 2
"""Beyond chance, seen and held out together; and how many rivals are asked, at most."""
COASTS = frozenset({"contact", "load_friction"})
"""What a load that coasts has already: a rival of that name is in the joint fit."""


def rivals_of(one: Named, there: Collection[str]) -> list[Contender]:
    """Who competed with a cause in its round, the best one first.

    None are: what is of its class; who does worse than nothing on what was held out, however well
    it may fit; what is `there` as well; and a coupling that led by chance, which was passed over
    for a name.
    """
    out = {one.effect, *class_of(one.effect), *there}
    others = [c for c in one.round.contenders if c is not one.contender and c.effect not in out]
    able = [c for c in others if c.held_gain > 0.0 and not _is_passed_over(one, c)]
    return sorted(able, key=lambda c: c.total)


def _is_passed_over(one: Named, rival: Contender) -> bool:
    led = rival.total < one.contender.total
    by_chance = block_z(rival.costs, one.contender.costs) < BY_CHANCE
    coupling = rival.effect in SPRINGS - {VEHICLE} and one.effect not in SPRINGS
    return coupling and led and by_chance


def beside_the_unlike(
    final: Found,
    named: Sequence[Named],
    late: Late,
    *,
    there: Collection[str] = (),
) -> list[Named]:
    """The causes; one that unlike rivals come near by chance with a round beside such a rival, on
    all that was recorded, where it is missed there beyond chance. What is named too, or is `there`
    (too small for a name, or read off), is no rival."""
    kept, known = list[Named](), {*there, *(n.effect for n in named)}
    for one in named:
        rivals = _unlike(one, known)
        believed = one.effect in dict(late.scales.believed)  # its round compared it with that
        others = frozenset().union(*(brought_by(n, n.contender) for n in named if n is not one))
        beside = []
        for rival in () if believed else rivals:
            late.report(f"{one.effect} beside {rival.effect}")
            beside.append(_beside(late, final, (one, rival), others))
        missed = [b for b in beside if b is not None]
        kept.append(missed[0] if missed and len(missed) == len(rivals) else one)
    return kept


def _unlike(one: Named, there: Collection[str]) -> list[Contender]:
    """The rivals of a cause's round that it does not lead beyond chance, where all of them change
    something else; a coupling, which fits a part of anything, has none, and nobody has many."""
    if one.missed_z is not None or one.effect != one.contender.effect or one.effect in SPRINGS:
        return []
    near = [c for c in rivals_of(one, there) if block_z(one.contender.costs, c.costs) < RIVAL_Z]
    like = any(abs(one.round.likeness(one.contender, c)) >= LIKE for c in near)
    return [] if like or len(near) > MOST else near


def _beside(
    late: Late, final: Found, pair: tuple[Named, Contender], others: frozenset[str]
) -> Named | None:
    """The cause in a round whose base has the rival; None where it is not clearly missed there, is
    worth no name there, or the two cannot be in one rig."""
    one, rival = pair
    coasts = COASTS if is_coasting(final.model) else frozenset[str]()
    new = brought_by(one, rival) - others - coasts
    if rival.effect not in new | coasts:  # another cause brought it
        return None
    try:
        both, less = _with_and_without(late, final, pair, new, others)
    except (FitError, SimRigError, np.linalg.LinAlgError):
        return None
    played = faced(late.whole, less, [(both, one.contender.hypothesis)], one.round.screened)
    first = played.contenders[0]
    own = own_unknowns(first, one.effect)
    found = Named(one.effect, played, first, own, beside=rival.effect)
    clearly = is_sure(first) and together(first) > CLEARLY_Z
    takes = min(first.seen_gain, first.held_gain) > NEEDED_SHARE
    return found if clearly and takes and is_worth_it(found, both, late.scales) else None


def _with_and_without(
    late: Late,
    final: Found,
    pair: tuple[Named, Contender],
    new: frozenset[str],
    others: frozenset[str],
) -> tuple[Found, Found]:
    """The joint fit with the rival and all that came with it (`new`), and that without the cause:
    gone on from there, or from the rival's own end, whichever comes lower."""
    one, rival = pair
    gone = brought_by(one, one.contender) - others
    model, mine = final.model, [u for u in rival.found.unknowns if u.effect in new - gone]
    for effect in new - gone:
        model = model.with_effect(effect, **rival.found.model.effects[effect]._asdict())
    start = put(final, model, merged(final.unknowns, mine))
    both = sought_again(late.whole, start, new - gone)
    ends = list[Found]()
    with suppress(FitError, SimRigError, np.linalg.LinAlgError):
        ends.append(sought_instead(late.whole, final, gone, (rival, new), late.band))
    if not new & gone:
        ends.append(sought_without(late.whole, both, {one.effect, *(gone - SPRINGS)}, late.band))
    if not ends:
        raise FitError(f"{rival.effect} can be sought on this rig from nowhere.")
    return both, min(ends, key=lambda end: end.errors.cost(final.sigma))
