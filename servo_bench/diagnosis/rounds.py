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

from servo_bench.diagnosis.evidence import Errors, Evidence, block_z
from servo_bench.diagnosis.hypotheses import SPRINGS, VEHICLE, Hypothesis, Trial
from servo_bench.diagnosis.rows import Array
from servo_bench.diagnosis.screening import Screened, screen
from servo_bench.diagnosis.seeking import Found, seek, settle
from servo_bench.diagnosis.unknowns import Unknown
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
SHORTEST_BRISTLE_RAD = 2e-5


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
) -> Round:
    """Screen and fit. Contenders may be empty: then nothing promised anything.

    `sizes` are those below which an effect is worth no name: what promises little, and is so small,
    is not fitted; nor is what promises less than `least` of the cost.
    """
    told("screening")
    screened = screen(quick, base, hypotheses)
    able = [s for s in screened if s.gain > WORTH_ANYHOW or _largest(s) > _most(s, sizes)]
    worth = [s for s in able if s.gain > max(least, WORTH * able[0].gain)][:FITTED]
    worth += [s for s in able if s.hypothesis.effect in _plain(worth)]
    first: list[tuple[Screened, Found]] = []
    for one in worth:
        told(f"fitting {one.hypothesis.effect}")
        try:
            first.append((one, _fitted(quick, base, one)))
        except FitError:
            continue
    if not first:
        judged = quick.held_out([base.model])[0]
        costs = _all_costs(base.errors, judged, base.sigma)
        return Round(base, judged, costs, base.sigma, (), screened)
    best = min(first, key=lambda pair: pair[1].cost)[1]
    sigma = quick.deviation(best.errors)
    told("comparing")
    ranked = sorted(first, key=lambda pair: pair[1].cost)
    near = ranked[:3]
    plain = _plain([one for one, _ in near])
    near += [pair for pair in ranked[3:] if pair[0].hypothesis.effect in plain]
    again = [(one, _again(quick, one, f, sigma)) for one, f in near]
    beside = [m for one, f in again if (m := _less(f.model, _not_the_base_s(base, one)))]
    rested = _rested(quick, base, sigma, beside)
    return faced(quick, rested, [(f, one.hypothesis) for one, f in again], screened, sigma=sigma)


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


def _largest(one: Screened) -> float:
    """Of the sizes that its search would start from."""
    return max(t.size for t in (one.trial, *one.tried))


def _most(one: Screened, sizes: Mapping[str, float]) -> float:
    """Sizes below are not fitted: a template tells a size to within a factor."""
    return 0.6 * sizes.get(one.hypothesis.effect, 0.0)


def _fitted(quick: Evidence, base: Found, one: Screened) -> Found:
    """From the best of a few sizes: what a template foretells is often too much. What is steep is
    sought from each of a few trials."""
    if one.tried:
        ends = [_from(quick, base, one.hypothesis, trial, [trial]) for trial in one.tried]
        return min(ends, key=lambda end: end.cost)
    masses = MASSES if VEHICLE in one.trial.beside else (1.0,)
    starts = [one.trial.times(s).carrying(m) for s, m in product(STARTS, masses)]
    return _from(quick, base, one.hypothesis, one.trial, starts)


def _from(
    quick: Evidence, base: Found, hypothesis: Hypothesis, trial: Trial, starts: Sequence[Trial]
) -> Found:
    """The search from the best of its starts. Raises FitError where none can be on this rig."""
    unknowns = merged(base.unknowns, hypothesis.unknowns(base.model, trial))
    models = []
    for start in starts:
        try:
            models.append(start.on(base.model))
        except SimRigError:
            continue
    if not models:
        raise FitError(f"{hypothesis.effect} can be tried on this rig at no size.")
    costs = [errors.cost(base.sigma) for errors in quick.seen(models)]
    return seek(quick, models[int(np.argmin(costs))], unknowns, base.sigma, iterations=2)


def _again(quick: Evidence, one: Screened, found: Found, sigma: Array) -> Found:
    """The same search, weighed by what the best one leaves."""
    again = seek(quick, found.model, found.unknowns, sigma, iterations=3, first=1)
    return settle(quick, again, _own(one), turns=1)


def _rested(quick: Evidence, base: Found, sigma: Array, beside: Sequence[Model]) -> Found:
    """The base with as much search as its contenders have had, from its own numbers and theirs.

    Else a contender wins by what the base's own open numbers had left to gain.
    """
    cold = seek(quick, base.model, base.unknowns, sigma, iterations=3, first=1)
    costs = [errors.cost(sigma) for errors in quick.seen(beside)]
    warm = [beside[int(np.argmin(costs))]] if beside else []
    found = [
        seek(quick, m, base.unknowns, sigma, iterations=2, first=2) for m in (cold.model, *warm)
    ]
    return min(found, key=lambda f: f.cost)


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


def merged(old: Sequence[Unknown], new: Sequence[Unknown]) -> tuple[Unknown, ...]:
    """The old ones, less those that the new ones stand for, and the new ones."""
    names = {u.name for u in new}
    return (*(u for u in old if u.name not in names), *new)


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
