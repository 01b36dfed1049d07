"""One cause after another: screen, fit the best, let them compete, accept or stop.

round     screen every hypothesis on the recording's beginning -> fit the most promising on it
          -> weigh all by what the best one leaves -> refit -> best against its rivals, by the
          cost of all blocks, those that no fit saw among them
accepted  beyond the gate (see `gate`): becomes part of the base, its numbers stay free
at last   every accepted cause is taken away once; one whose absence costs less than the gate
          is dropped (backward deletion)
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Errors, Evidence, block_z
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.searching.approaching import approached
from servo_bench.diagnosis.searching.classes import siblings_of
from servo_bench.diagnosis.searching.hypotheses import SPRINGS, VEHICLE, Hypothesis, Trial
from servo_bench.diagnosis.searching.screening import Screened, screen
from servo_bench.diagnosis.searching.seeking import Found, seek, settle
from servo_bench.diagnosis.searching.stepping import surprise
from servo_bench.diagnosis.searching.unknowns import merged
from servo_bench.errors import FitError
from sim_rig.effects import find_effect
from sim_rig.effects.effect import Port
from sim_rig.errors import EffectError, SimRigError
from sim_rig.model import Model

FITTED = 4
"""Hypotheses that are fitted in a round, at most."""
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
ALIKE, ONE_KIND_ALIKE, AS_GOOD = 0.95, 0.9, 0.04
"""Contenders that change the same, and of which none gains so much more, are told apart by how
much they assume: the one with fewer free numbers and the shorter law is taken. Where one refines
the other less likeness is enough."""
RIVAL_Z, LIKE = 3.0, 0.8
"""What lies less behind, and changes so much the same, is a near rival."""
Told = Callable[[str], None]
REFINES = {"pre_sliding": "coulomb", "thermal_friction": "coulomb", "stribeck": "coulomb"}
"""Friction of its own kind that Coulomb friction does nearly as well."""
CLEARLY = 4.0
BESIDE = (1.0, 0.5, 0.25, 0.05)
"""Of a search's strengths, beside the numbers that the base's own search ended with."""
SHORTEST_BRISTLE_RAD = 2e-5
SETTLED, HOPEFUL = 2, 0.3
"""Widths that a search skips beside a base that is settled; and of the best one's gain, what one
must have there to be sought any further."""


@dataclass(frozen=True)
class Contender:
    """A hypothesis fitted beside the base, and what it gains there.

    `seen_z`, `held_z`: advantage over the base in block scatter; `held_gain`: share of the base's
    held-out cost that goes; `costs`: all blocks, seen and held out.
    """

    hypothesis: Hypothesis
    found: Found
    held: Errors
    seen_z: float
    held_z: float
    seen_gain: float
    held_gain: float
    costs: Array

    @property
    def effect(self) -> str:
        """The effect's name."""
        return self.hypothesis.effect

    @property
    def total(self) -> float:
        """The cost of everything."""
        return float(self.costs.sum())


@dataclass(frozen=True)
class Round:
    """What one round found: the base, contenders from the best, and all that was screened: nothing
    where the one contender was free in every fit already (`faced`)."""

    base: Found
    base_held: Errors
    base_costs: Array
    sigma: Array
    contenders: tuple[Contender, ...]
    screened: tuple[Screened, ...]

    def likeness(self, one: Contender, other: Contender) -> float:
        """Cosine between what two contenders change in the base's error."""
        here = self.base.errors.white(self.sigma)
        a = one.found.errors.white(self.sigma) - here
        b = other.found.errors.white(self.sigma) - here
        size = float(np.linalg.norm(a) * np.linalg.norm(b))
        return float(a @ b) / size if size > 0.0 else 0.0

    def near(self, one: Contender) -> tuple[Contender, ...]:
        """Rivals of other effects that change the same, and are not beyond chance worse."""
        return tuple(
            c
            for c in self.contenders
            if c.effect != one.effect
            and block_z(one.costs, c.costs) < RIVAL_Z
            and self.likeness(one, c) > LIKE
        )


def play_round(
    quick: Evidence,
    base: Found,
    hypotheses: Sequence[Hypothesis],
    sizes: Mapping[str, float],
    told: Told,
    *,
    least: float = LEAST_GAIN,
    settled: bool = False,
    scouted: Evidence | None = None,
) -> Round:
    """Screen and fit. Contenders may be empty: then nothing promised anything.

    `sizes` are those below which an effect is worth no name: what promises little, and is so small,
    is not fitted; nor is what promises less than `least` of the cost. Beside a base that is
    `settled` on these very data searches begin with narrow differences, and one that gains nothing,
    or far less than the best, goes no further. What rings shows in little of what was recorded:
    where a spring's searches begin may be `scouted` there.
    """
    told("screening")
    screened = screen(quick, base, hypotheses)
    able = [s for s in screened if s.gain > WORTH_ANYHOW or _largest(s) > _most(s, sizes)]
    worth = [s for s in able if s.gain > max(least, WORTH * able[0].gain)][:FITTED]
    also = _plain(worth) | _siblings(worth)
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
        judged = quick.held_out([base.model])[0]
        costs = _all_costs(base.errors, judged, base.sigma)
        return Round(base, judged, costs, base.sigma, (), screened)
    best = min(first, key=lambda pair: pair[1].cost)[1]
    sigma = quick.deviation(best.errors)
    told("comparing")
    ranked = sorted(first, key=lambda pair: pair[1].cost)
    near = ranked[:3]
    beside = _plain([one for one, _ in near])
    beside |= _siblings([one for one, _ in near])
    near += [pair for pair in ranked[3:] if pair[0].hypothesis.effect in beside]
    again = [(one, _again(quick, one, f, sigma)) for one, f in near]
    without = [m for one, f in again if (m := _less(f.model, _not_the_base_s(base, one)))]
    cold = base if settled else _sought(quick, base, sigma)
    rested = _rested(quick, cold, sigma, without)
    ends = [(gone_on(quick, rested, f, _own(one)), one.hypothesis) for one, f in again]
    return faced(quick, rested, ends, screened, sigma=sigma)


def faced(
    evidence: Evidence,
    base: Found,
    found: Sequence[tuple[Found, Hypothesis]],
    screened: tuple[Screened, ...] = (),
    *,
    sigma: Array | None = None,
) -> Round:
    """A round of contenders that have been sought already, the best one first; weighed by what that
    leaves where no `sigma` is given."""
    if sigma is None:
        sigma = evidence.deviation(min((f for f, _ in found), key=lambda f: f.cost).errors)
    held = evidence.held_out([base.model, *(f.model for f, _ in found)])
    beside = _Beside(base, held[0], sigma)
    contenders = [
        _contender(hypothesis, f, h, beside)
        for (f, hypothesis), h in zip(found, held[1:], strict=True)
    ]
    contenders.sort(key=lambda c: c.total)
    base_costs = _all_costs(base.errors, held[0], sigma)
    played = Round(base, held[0], base_costs, sigma, tuple(contenders), screened)
    return replace(played, contenders=_simplest_first(played))


def _simplest_first(played: Round) -> tuple[Contender, ...]:
    """The best one, unless a simpler one does the same as well."""
    best = played.contenders[0]
    gained = float(played.base_costs.sum()) - best.total
    alike = [
        c
        for c in played.contenders
        if played.likeness(best, c) > _least_likeness(best, c)
        and c.total - best.total < AS_GOOD * gained
        and (block_z(best.costs, c.costs) < CLEARLY or _degenerate(best))
    ]
    first = min(alike, key=lambda c: _assumes(c.effect)) if alike else best
    return (first, *(c for c in played.contenders if c is not first))


def _least_likeness(best: Contender, plain: Contender) -> float:
    return ONE_KIND_ALIKE if REFINES.get(best.effect) == plain.effect else ALIKE


def _degenerate(contender: Contender) -> bool:
    """Whether bristles so short that they only slide: Coulomb friction by another name."""
    params = contender.found.model.effects[contender.effect]
    return float(getattr(params, "breakaway_angle_rad", 1.0)) < SHORTEST_BRISTLE_RAD


def _assumes(effect: str) -> tuple[int, int, bool]:
    """Memory, parameters, and a place behind the motor: how much a hypothesis assumes."""
    found = find_effect(effect)
    memory = len(found.memory._fields) if found.memory is not None else 0
    return memory, len(found.parameters), found.port is Port.LOAD_TORQUE


def _plain(found: Sequence[Screened]) -> set[str]:
    """What those that are there must beat: the plain cause that they refine."""
    names = {s.hypothesis.effect for s in found}
    return {REFINES[name] for name in names if name in REFINES} - names


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
        return min(ends, key=lambda end: end.cost)
    masses = MASSES if VEHICLE in one.trial.beside else (1.0,)
    shares = (*STARTS, *NEAR) if one.trial.effect in CUTTING else STARTS
    sizes = [one.trial.times(s).carrying(m) for s, m in product(shares, masses)]
    return _from(quick, base, one.hypothesis, sizes, first)


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


def _less(model: Model, effects: Collection[str]) -> Model | None:
    """The model without these; None where what is left makes no rig."""
    try:
        return model.without(*effects)
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


class _Beside(NamedTuple):
    """What contenders are compared with."""

    base: Found
    held: Errors
    sigma: Array


def _contender(hypothesis: Hypothesis, found: Found, held: Errors, beside: _Beside) -> Contender:
    base, sigma = beside.base, beside.sigma
    return Contender(
        hypothesis=hypothesis,
        found=found,
        held=held,
        seen_z=block_z(found.errors.costs(sigma), base.errors.costs(sigma)),
        held_z=block_z(held.costs(sigma), beside.held.costs(sigma)),
        seen_gain=1.0 - found.errors.cost(sigma) / base.errors.cost(sigma),
        held_gain=1.0 - held.cost(sigma) / beside.held.cost(sigma),
        costs=_all_costs(found.errors, held, sigma),
    )


def _all_costs(seen: Errors, held: Errors, sigma: Array) -> Array:
    return np.concatenate([seen.costs(sigma), held.costs(sigma)])
