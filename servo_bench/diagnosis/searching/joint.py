"""All that was accepted, on all that was recorded: what is needed, and what carries it.

joint fit   every open number at once, in fine steps, until nothing helps (`settle`)
deletion    each cause is taken away once; one that the joint fit does not miss is dropped
vehicle     a load with a mass, on which a cause was tried, is a cause too where it is needed
name        what is smaller than every rig has is absorbed, or gives its name to what carries it
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence, block_z
from servo_bench.diagnosis.searching.bounces import on_other_faces
from servo_bench.diagnosis.searching.coasting import is_coasting
from servo_bench.diagnosis.searching.contenders import REFINES, Contender, Round
from servo_bench.diagnosis.searching.gate import (
    RIGHT,
    WARMS,
    grows,
    is_felt,
    is_material,
    misfit,
    stands_far_out,
    strength_of,
)
from servo_bench.diagnosis.searching.hypotheses import ON_THE_LOAD, SPRINGS, VEHICLE
from servo_bench.diagnosis.searching.rounds import Told
from servo_bench.diagnosis.searching.scales import Scales
from servo_bench.diagnosis.searching.seeking import Found, seek, settle
from servo_bench.diagnosis.searching.unknowns import Unknown, merged
from sim_rig.effects import find_effect
from sim_rig.errors import EffectError
from sim_rig.model import Model

NEEDED_Z, NEEDED_SHARE = 4.0, 0.01
SOME = 0.04
"""Of what was seen, and of what was held out, that a coupling takes at least; or it stands far out
beside a load that coasts."""
CARRIERS = {"anti_windup": "current_limit"}
"""Effects that act beside another only, which is a cause by itself."""


@dataclass(frozen=True)
class Named:
    """An accepted cause and the round that found it.

    `missed_z`, for what had no round of its own but carried another: by how much, in block scatter,
    the joint fit is better than one without it. `beside`, where the round's base has a rival, which
    effect that is (`unlike`). `as_well`: what takes its place and explains as much (`as_a_torque`).
    """

    effect: str
    round: Round
    contender: Contender
    unknowns: tuple[Unknown, ...]
    missed_z: float | None = None
    beside: str = ""
    as_well: frozenset[str] = frozenset()


def fit_jointly(
    whole: Evidence,
    now: Found,
    named: list[Named],
    band: Sequence[Unknown],
    report: Told,
    *,
    small: int = 0,
) -> tuple[Found, list[Named]]:
    """Everything accepted on all that was recorded; what is not needed is taken out again.

    One cause alone is needed; not so beside what was accepted and is too `small` for a name,
    nor of what turns a load beside a mass of the load's own, which may have taken its place since.
    """
    final = seek(whole, now.model, now.unknowns, iterations=2, first=3, coarse=False)
    own = {u.effect for u in now.unknowns if u not in band}
    final = settle(whole, final, own, turns=3, coarse=False)
    if (
        VEHICLE in own
        and not is_coasting(final.model)
        and float(misfit(whole, final.errors).max()) > RIGHT
    ):
        report("other faces")
        final = on_other_faces(whole, final, own)
    kept, asked = list(named), list(named)
    for one in asked:
        moves = VEHICLE in own and one.effect in ON_THE_LOAD
        alone = len(kept) + small < 2 and not moves
        if alone or _is_in_its_band(one.effect, final, band):
            continue
        report(f"without {one.effect}")
        try:
            less = without_effect(whole, final, one.effect, band)
        except EffectError:  # the others need it: a load of the inertia that it adds
            continue
        if not is_missed(whole, final, less, one.effect, kept):
            left = _carrier_of(one, less, kept)
            place = kept.index(one)
            kept[place : place + 1] = left
            asked += left
            final = less
    return final, kept


def _carrier_of(one: Named, less: Found, kept: Sequence[Named]) -> list[Named]:
    """What a cause acted beside, where a fit without it has that still and it has no name yet."""
    carrier = CARRIERS.get(one.effect)
    is_open = any(u.effect == carrier for u in less.unknowns)
    if carrier is None or not is_open or any(n.effect == carrier for n in kept):
        return []
    return [carried_by(one, carrier)]


def _is_in_its_band(effect: str, final: Found, band: Sequence[Unknown]) -> bool:
    """Whether every rig may have as much of it, so that a fit without it has it all the same."""
    own = [u for u in band if u.effect == effect]
    return bool(own) and all(u.low <= u.of(final.model) <= u.high for u in own)


def own_unknowns(contender: Contender, effect: str) -> tuple[Unknown, ...]:
    """The open numbers of one effect."""
    return tuple(u for u in contender.found.unknowns if u.effect == effect)


def needed_vehicle(
    whole: Evidence, final: Found, named: Sequence[Named], band: Sequence[Unknown], report: Told
) -> list[Named]:
    """What a cause was tried on, where it is there and the cause alone would not do."""
    for one in named:
        for effect in {u.effect for u in one.contender.found.unknowns} & {VEHICLE}:
            if any(n.effect == effect for n in named) or not is_felt(final.model):
                continue
            report(f"without {effect}")
            less = without_effect(whole, final, effect, band)
            if is_needed(final, less):
                mine = own_unknowns(one.contender, effect)
                return [Named(effect, one.round, one.contender, mine, _advantage(final, less))]
    return []


def is_needed(final: Found, less: Found) -> bool:
    """Whether a joint fit misses what was taken out of it."""
    return _advantage(final, less) > NEEDED_Z and share_of(final, less) > NEEDED_SHARE


def is_missed(
    whole: Evidence, final: Found, less: Found, effect: str, named: Sequence[Named]
) -> bool:
    """Whether a joint fit misses a cause; one that warms also by what was held out, which comes
    last and has most of it. Of friction another speed would do the same, so that it has to be
    beside the friction that it warms from."""
    if is_needed(final, less):
        return True
    plain = REFINES.get(effect)
    if effect not in WARMS or not (plain is None or any(n.effect == plain for n in named)):
        return False
    held = whole.held_out([final.model, less.model])
    with_it, without = (errors.costs(final.sigma) for errors in held)
    takes = 1.0 - float(with_it.sum() / without.sum())
    return takes > NEEDED_SHARE and grows(_advantage(final, less), block_z(with_it, without))


def share_of(final: Found, less: Found) -> float:
    """What it takes of the cost that is there without it."""
    return 1.0 - final.errors.cost(final.sigma) / less.errors.cost(final.sigma)


def _advantage(final: Found, less: Found) -> float:
    return block_z(final.errors.costs(final.sigma), less.errors.costs(final.sigma))


def is_worth_it(one: Named, found: Found, scales: Scales, *, right: bool = False) -> bool:
    """Whether a cause is larger in this fit than what every rig has. Where all is `right` without
    it, what it takes of the rest makes nothing smaller a cause: 0.19 mN m of an uneven bearing took
    a fifth.

    Beside a load that coasts a spring fits nothing else: there what was seen counts as well. Of
    rigs with nothing wrong it took 2.4 % of that at most, of 14, and of what was held out 12 %.
    Where a torque presses the load to its faces, which give way as well, a coupling must take some
    of both. Nowhere is a coupling one that takes next to nothing of what was seen.
    """
    gain, seen_gain = one.contender.held_gain, one.contender.seen_gain
    coasts = is_coasting(found.model)
    far_out = coasts and stands_far_out(one.contender)
    if one.effect in SPRINGS - {VEHICLE} and min(gain, seen_gain) < SOME and not far_out:
        return False
    if one.effect in SPRINGS and coasts:
        gain = max(gain, seen_gain)
    elif one.effect in SPRINGS - {VEHICLE} and ON_THE_LOAD & found.model.effects.keys():
        gain = min(gain, seen_gain)
    if right and one.effect not in SPRINGS:
        gain = 0.0
    return is_material(found.model, one.effect, scales, gain)


def worth_a_name(
    one: Named, found: Found, scales: Scales, *, right: bool = False
) -> tuple[Named, ...]:
    """The cause, where it is more than what every rig has; else what it needs beside it."""
    if is_worth_it(one, found, scales, right=right):
        return (one,)
    carrier = CARRIERS.get(one.effect)
    return () if carrier is None else (carried_by(one, carrier),)


def carried_by(one: Named, carrier: str) -> Named:
    """The effect that a cause acted beside, in its place."""
    return replace(one, effect=carrier, unknowns=own_unknowns(one.contender, carrier))


def without_effect(
    whole: Evidence, final: Found, effect: str, band: Sequence[Unknown], iterations: int = 2
) -> Found:
    """The final search again without one effect, or with it back in its band.

    What it made goes to a refinement that stays, where the search begins lower so: two frictions of
    one kind share what either makes alone. Raises EffectError where what is left makes no rig.
    """
    back = tuple(u for u in band if u.effect == effect)
    kept = tuple(u for u in final.unknowns if u.effect != effect)
    model = final.model.without(effect)
    for unknown in back:
        model = unknown.put(
            model, float(np.clip(unknown.of(final.model), unknown.low, unknown.high))
        )
    starts = [model, *_taken_over(final.model, model, effect)]
    costs = [errors.cost(final.sigma) for errors in whole.seen(starts)]
    start = starts[int(np.argmin(costs))]
    return seek(whole, start, merged(kept, back), final.sigma, iterations=iterations, first=1)


def _taken_over(before: Model, less: Model, effect: str) -> Iterator[Model]:
    """The model without an effect, where one that refines it has its strength and its shape."""
    for refined, plain in REFINES.items():
        if plain != effect or refined not in less.effects:
            continue
        had = before.effects[plain]._asdict()
        params = less.effects[refined]._asdict()
        strength = find_effect(refined).strengths[0]
        params |= {n: v for n, v in had.items() if n in params and n != strength}
        params[strength] += strength_of(before, plain) - strength_of(less, plain)
        yield less.with_effect(refined, **params)
