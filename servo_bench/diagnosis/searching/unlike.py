"""A cause and a rival that changes something else: not one or the other, but one, or both.

Two hypotheses that take as much of the cost each are rivals where they change the same. A dead time
that changes the motor's way at low speed and a coupling that stood in for a load's motion in its
gap do not: that they were as good says nothing of either. What does is whether the cause is missed
where the rival is there too, beside everything that was found since.
"""

from collections.abc import Collection, Sequence

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence, block_z
from servo_bench.diagnosis.searching.classes import class_of
from servo_bench.diagnosis.searching.coasting import OTHERWISE, is_coasting
from servo_bench.diagnosis.searching.contenders import LIKE, RIVAL_Z, Contender, faced
from servo_bench.diagnosis.searching.gate import is_sure
from servo_bench.diagnosis.searching.hypotheses import SPRINGS
from servo_bench.diagnosis.searching.joint import NEEDED_SHARE, Named, own_unknowns
from servo_bench.diagnosis.searching.late import Late
from servo_bench.diagnosis.searching.runoff import (
    brought_by,
    put,
    sought_again,
    sought_without,
)
from servo_bench.diagnosis.searching.seeking import Found
from servo_bench.diagnosis.searching.unknowns import Unknown, merged
from servo_bench.errors import FitError
from sim_rig.errors import SimRigError


def beside_the_unlike(
    final: Found,
    named: Sequence[Named],
    late: Late,
    *,
    small: Collection[str] = (),
) -> list[Named]:
    """The causes; one that an unlike rival comes near by chance with a round beside that rival, on
    all that was recorded, where it is missed there beyond chance. What is named too, or too `small`
    for it, is there already, and no rival."""
    whole, band, report = late.whole, late.band, late.report
    kept, there = [], {*small, *(n.effect for n in named)}
    for one in named:
        rival = _unlike(one, there)
        if rival is None:
            kept.append(one)
            continue
        report(f"{one.effect} beside {rival.effect}")
        others = frozenset().union(*(brought_by(n, n.contender) for n in named if n is not one))
        kept.append(_beside(whole, final, (one, rival), others, band) or one)
    return kept


def _unlike(one: Named, there: set[str]) -> Contender | None:
    """The best rival of a cause's round, none of those that are there, where they are apart by
    chance and change different things; a coupling, which fits a part of anything, has none."""
    if one.missed_z is not None or one.effect in SPRINGS:
        return None
    able = (c for c in one.round.contenders if c is not one.contender and c.held_gain > 0.0)
    able = (c for c in able if c.effect not in SPRINGS or c.total > one.contender.total)
    rival = next((c for c in able if c.effect not in there | class_of(one.effect)), None)
    if rival is None or abs(block_z(one.contender.costs, rival.costs)) > RIVAL_Z:
        return None
    return rival if abs(one.round.likeness(one.contender, rival)) < LIKE else None


def _beside(
    whole: Evidence,
    final: Found,
    pair: tuple[Named, Contender],
    others: frozenset[str],
    band: Sequence[Unknown],
) -> Named | None:
    """The cause in a round whose base has the rival; None where it is not clearly missed there, or
    the two cannot be in one rig."""
    one, rival = pair
    gone = brought_by(one, one.contender) - others
    new = brought_by(one, rival) - gone - others
    new -= OTHERWISE if is_coasting(final.model) else set()  # the load moves so already
    try:
        model, mine = final.model, [u for u in rival.found.unknowns if u.effect in new]
        for effect in new:
            model = model.with_effect(effect, **rival.found.model.effects[effect]._asdict())
        both = sought_again(whole, put(final, model, merged(final.unknowns, mine)), new)
        less = sought_without(whole, both, {one.effect, *(gone - SPRINGS)}, band)
    except (FitError, SimRigError, np.linalg.LinAlgError):
        return None
    played = faced(whole, less, [(both, one.contender.hypothesis)], one.round.screened)
    first = played.contenders[0]
    if not is_sure(first) or min(first.seen_gain, first.held_gain) < NEEDED_SHARE:
        return None
    return Named(one.effect, played, first, own_unknowns(first, one.effect))
