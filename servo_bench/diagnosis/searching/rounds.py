"""One cause after another: screen, fit the best, let them compete, accept or stop.

round     screen every hypothesis on the recording's beginning -> fit the most promising on it
          -> weigh all by what the best one leaves -> refit -> best against its rivals, by the
          cost of all blocks, those that no fit saw among them
accepted  beyond the gate (see `gate`): becomes part of the base, its numbers stay free
at last   every accepted cause is taken away once; one whose absence costs less than the gate
          is dropped (backward deletion)
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Errors, Evidence
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.searching.approaching import approached
from servo_bench.diagnosis.searching.classes import siblings_of
from servo_bench.diagnosis.searching.coasting import with_coasting
from servo_bench.diagnosis.searching.contenders import REFINES, Round, all_costs, faced
from servo_bench.diagnosis.searching.gate import RIGHT, misfit
from servo_bench.diagnosis.searching.hypotheses import SPRINGS, VEHICLE, Hypothesis, Trial
from servo_bench.diagnosis.searching.refining import BRISTLES, must_show_itself, shows_itself
from servo_bench.diagnosis.searching.screening import Screened, screen
from servo_bench.diagnosis.searching.seeking import Found, seek, settle
from servo_bench.diagnosis.searching.stepping import surprise
from servo_bench.diagnosis.searching.unknowns import merged
from servo_bench.errors import FitError
from sim_rig.effects import find_effect
from sim_rig.errors import EffectError, SimRigError
from sim_rig.model import Model

FITTED, FOREMOST = 4, 3
"""Hypotheses that are fitted in a round, at most; and that are sought to their ends."""
WORTH = 0.15
"""Screened gain, as a share of the best one's, below which nothing is fitted."""
LEAST_GAIN = 0.001
WORTH_ANYHOW = 0.05
STARTS, MASSES = (1.0, 0.5, 0.25, 2.0), (1.0, 0.5, 0.25, 0.12)
"""Of a trial's size, and of the mass that its vehicle carries: how a load slows is the two's ratio,
and a search from a wrong one ends far off."""
CUTTING = frozenset({"current_limit", "integrator_clamp"})
NEAR = (0.94, 0.88, 0.82, 0.75)
"""Of a trial's size too, of what cuts off: an eighth less may cut nothing, which has no slope."""
CLOSE = 1.25
"""Of the lowest cost: how much higher another valley of a coupling may be, and yet be the right one
beside a load that coasts. One of 1.10 went to 0.42 of it there."""
Told = Callable[[str], None]
BESIDE = (1.0, 0.5, 0.25, 0.05)
"""Of a search's strengths, beside the numbers that the base's own search ended with."""
SETTLED, HOPEFUL = 2, 0.3
"""Widths that a search skips beside a base that is settled; and of the best one's gain, what one
must have there to be sought any further."""


def play_round(
    quick: Evidence,
    base: Found,
    hypotheses: Sequence[Hypothesis],
    sizes: Mapping[str, float],
    told: Told,
    *,
    least: float = LEAST_GAIN,
    least_of_springs: float = 0.0,
    settled: bool = False,
    scouted: Evidence | None = None,
) -> Round:
    """Screen and fit. Contenders may be empty: then nothing promised anything.

    `sizes` are those below which an effect is worth no name: what promises little, and is so small,
    is not fitted; nor is what promises less than `least` of the cost, or a spring, whose search is
    long, that promises less than `least_of_springs`. Beside a base that is
    `settled` on these very data searches begin with narrow differences, and one that gains nothing,
    or far less than the best, goes no further. What rings shows in little of what was recorded:
    where a spring's searches begin may be `scouted` there.
    """
    told("screening")
    screened = screen(quick, base, hypotheses)
    able = [s for s in screened if s.gain > WORTH_ANYHOW or _largest(s) > _most(s, sizes)]
    able = [s for s in able if s.hypothesis.effect not in SPRINGS or s.gain > least_of_springs]
    worth = [s for s in able if s.gain > max(least, WORTH * able[0].gain)][:FITTED]
    also = _plain(worth) | _siblings(worth) | _bristles(worth)
    worth += [s for s in able if s.hypothesis.effect in also]
    first: list[tuple[Screened, Found]] = []
    for one in worth:
        told(f"fitting {one.hypothesis.effect}")
        try:
            began = SETTLED if settled else 0
            first.append((one, _fitted(quick, base, one, first=began, scouted=scouted)))
        except FitError:
            continue
    if settled:
        first = _hopeful(first, base)
    if not first:
        return _nothing(quick, base, screened)
    best = min(first, key=lambda pair: pair[1].cost)[1]
    sigma = quick.deviation(best.errors)
    told("comparing")
    ranked = sorted(first, key=lambda pair: pair[1].cost)
    near = _foremost(ranked)
    beside = _plain([one for one, _ in near])
    beside |= _siblings([one for one, _ in near])
    near += [pair for pair in ranked if pair[0].hypothesis.effect in beside]
    again = [(one, _again(quick, one, f, sigma)) for one, f in near]
    without = [m for one, f in again if (m := _less(f.model, _not_the_base_s(base, one), base))]
    cold = base if settled else _sought(quick, base, sigma)
    rested = _rested(quick, cold, sigma, without)
    ends = [(gone_on(quick, rested, f, _own(one)), one.hypothesis) for one, f in again]
    if must_show_itself({h.effect for h in hypotheses}, [h.effect for _, h in ends]):
        ends = [pair for pair in ends if shows_itself(quick, rested, pair[0], pair[1].effect)]
    if not ends:
        return _nothing(quick, base, screened)
    return faced(quick, rested, ends, screened, sigma=sigma)


def _nothing(quick: Evidence, base: Found, screened: tuple[Screened, ...]) -> Round:
    """A round without contenders."""
    judged = quick.held_out([base.model])[0]
    costs = all_costs(base.errors, judged, base.sigma)
    return Round(base, judged, costs, base.sigma, (), screened)


def _foremost(ranked: Sequence[tuple[Screened, Found]]) -> list[tuple[Screened, Found]]:
    """The first three; and where those are one law and what refines it, the first other one: a
    load's friction had no place behind the plain, the sliding and the warming one."""
    near = list(ranked[:FOREMOST])
    laws = {_law(one) for one, _ in near}
    if len(laws) == 1:
        near += [pair for pair in ranked[FOREMOST:] if _law(pair[0]) not in laws][:1]
    return near


def _law(one: Screened) -> str:
    return REFINES.get(one.hypothesis.effect, one.hypothesis.effect)


def _plain(found: Sequence[Screened]) -> set[str]:
    """What those that are there must beat: the plain cause that they refine."""
    names = {s.hypothesis.effect for s in found}
    return {REFINES[name] for name in names if name in REFINES} - names


def _bristles(found: Sequence[Screened]) -> set[str]:
    """What differs from plain friction by how it turns back alone, which no template tells: a limit
    and what comes with it had taken its place beside that."""
    names = {s.hypothesis.effect for s in found}
    return {BRISTLES} - names if REFINES[BRISTLES] in names else set()


def _siblings(found: Sequence[Screened]) -> set[str]:
    """What rests may tell from those that are there, and nothing else does."""
    names = {s.hypothesis.effect for s in found}
    return {e for name in names for e in siblings_of(name)} - names


def _hopeful(found: Sequence[tuple[Screened, Found]], base: Found) -> list[tuple[Screened, Found]]:
    """Those that gained, by no less than a share of what the best one did."""
    most = max((base.cost - f.cost for _, f in found), default=0.0)
    return [(one, f) for one, f in found if base.cost - f.cost > max(HOPEFUL * most, 0.0)]


def _largest(one: Screened) -> float:
    """Of the sizes that its search would start from."""
    return max(t.size for t in (one.trial, *one.tried))


def _most(one: Screened, sizes: Mapping[str, float]) -> float:
    """Sizes below are not fitted: a template tells a size to within a factor."""
    return 0.6 * sizes.get(one.hypothesis.effect, 0.0)


def _fitted(
    quick: Evidence,
    base: Found,
    one: Screened,
    *,
    first: int = 0,
    scouted: Evidence | None = None,
) -> Found:
    """From the best of a few sizes: what a template foretells is often too much. What is steep is
    sought from where a few of its trials came to."""
    if one.tried:
        where, beside = quick, base
        if scouted is not None and one.hypothesis.effect in SPRINGS:
            where = scouted
            beside = seek(where, base.model, base.unknowns, base.sigma, iterations=1, first=SETTLED)
        starts = approached(where, beside, one.hypothesis, one.tried)
        ends = [
            seek(quick, s.model, s.unknowns, base.sigma, iterations=2, first=first) for s in starts
        ]
        return _deepest(quick, ends, one.hypothesis.effect)
    masses = MASSES if VEHICLE in one.trial.beside else (1.0,)
    shares = (*STARTS, *NEAR) if one.trial.effect in CUTTING else STARTS
    sizes = [one.trial.times(s).carrying(m) for s, m in product(shares, masses)]
    return _from(quick, base, one.hypothesis, sizes, first)


def _deepest(quick: Evidence, ends: Sequence[Found], effect: str) -> Found:
    """The lowest; of couplings that leave the simulation wrong and end nearly alike, that which is
    lowest beside a load that coasts: its way through the gap hides which resonance is the right."""
    best = min(ends, key=lambda end: end.cost)
    close = [end for end in ends if end.cost < CLOSE * best.cost]
    wrong = float(misfit(quick, best.errors).max()) > RIGHT
    if effect not in SPRINGS - {VEHICLE} or len(close) < 2 or not wrong:
        return best
    coasting = [with_coasting(quick, end).cost for end in close]
    return close[int(np.argmin(coasting))]


def _from(
    quick: Evidence,
    base: Found,
    hypothesis: Hypothesis,
    starts: Sequence[Trial],
    first: int,
) -> Found:
    """The search from the best of its starts, whose first one tells its steps. Raises FitError
    where none can be on this rig."""
    unknowns = merged(base.unknowns, hypothesis.unknowns(base.model, starts[0]))
    models = []
    for start in starts:
        try:
            models.append(start.on(base.model))
        except SimRigError:
            continue
    if not models:
        raise FitError(f"{hypothesis.effect} can be tried on this rig at no size.")
    costs = [errors.cost(base.sigma) for errors in quick.seen(models)]
    nearest = models[int(np.argmin(costs))]
    return seek(quick, nearest, unknowns, base.sigma, iterations=2, first=first)


def _again(quick: Evidence, one: Screened, found: Found, sigma: Array) -> Found:
    """The same search, weighed by what the best one leaves."""
    again = seek(quick, found.model, found.unknowns, sigma, iterations=3, first=1)
    return settle(quick, again, _own(one), turns=1)


def _sought(quick: Evidence, base: Found, sigma: Array) -> Found:
    return seek(quick, base.model, base.unknowns, sigma, iterations=3, first=1)


def _rested(quick: Evidence, base: Found, sigma: Array, beside: Sequence[Model]) -> Found:
    """The base with as much search as its contenders have had, on from its own numbers and theirs.

    Else a contender wins by what the base's own open numbers had left to gain.
    """
    costs = [errors.cost(sigma) for errors in quick.seen(beside)]
    warm = [beside[int(np.argmin(costs))]] if beside else []
    found = [
        seek(quick, m, base.unknowns, sigma, iterations=2, first=2) for m in (base.model, *warm)
    ]
    return min(found, key=lambda f: f.cost)


def gone_on(quick: Evidence, rested: Found, found: Found, own: Collection[str]) -> Found:
    """A search, gone on from where the base's own ended if that is lower.

    With the numbers of `own` beside no search need end higher than the base's: one that does ended
    in another valley of the numbers that both have.
    """
    starts = []
    for share in BESIDE:
        try:
            starts.append(_put_beside(rested.model, found, own, share))
        except SimRigError:
            continue
    played = quick.seen(starts)
    costs = [_cost(found, m, errors) for m, errors in zip(starts, played, strict=True)]
    if min(costs, default=np.inf) >= found.cost:
        return found
    start = starts[int(np.argmin(costs))]
    again = seek(quick, start, found.unknowns, found.sigma, iterations=2, first=2)
    return min(again, found, key=lambda end: end.cost)


def _cost(found: Found, model: Model, errors: Errors) -> float:
    """Of another model of the same search."""
    values = np.array([u.of(model) for u in found.unknowns])
    return errors.cost(found.sigma) + surprise(found.unknowns, values)


def _put_beside(model: Model, found: Found, own: Collection[str], share: float) -> Model:
    """A search's own effects, at a share of their strengths, beside other numbers of the base."""
    mine = [u for u in found.unknowns if u.effect in own]
    for effect in own - model.effects.keys():
        sought = {u.field for u in mine if u.effect == effect}
        none = find_effect(effect).params()._asdict()
        params = found.model.effects[effect]
        fresh = params._replace(**{field: none[field] for field in sought})
        model = replace(model, effects={**model.effects, effect: fresh})
    for unknown in mine:
        is_strength = unknown.field in find_effect(unknown.effect).strengths
        here, there = unknown.of(model), unknown.of(found.model)
        model = unknown.put(model, here + share * (there - here) if is_strength else there)
    return model


def _less(model: Model, effects: Collection[str], base: Found) -> Model | None:
    """The model without these; None where what is left makes no rig.

    What a rig's file has of them stays as it is believed: a wave that is not there would be cured
    in the base for nothing.
    """
    sought = {u.effect for u in base.unknowns}
    believed = {n: base.model.effects[n] for n in base.model.effects.keys() & set(effects) - sought}
    try:
        return replace(model, effects={**model.without(*effects).effects, **believed})
    except EffectError:
        return None


def _not_the_base_s(base: Found, one: Screened) -> set[str]:
    """What a contender brought, and the base must do without to be compared with it.

    A load with a mass of its own, which carries some, may stay: nearly every rig has it, and only
    what acts on it is weighed. A limit that carries another effect is a cause itself.
    """
    carriers = _own(one) - {one.hypothesis.effect, *SPRINGS, *base.model.effects}
    return {one.hypothesis.effect, *carriers}


def _own(one: Screened) -> set[str]:
    """The effect and what carries it."""
    return {one.hypothesis.effect, *one.trial.beside}
