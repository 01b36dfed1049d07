"""Hypotheses that were fitted beside one base, and which of them comes first.

best      the lowest cost of all blocks, those that no fit saw among them
simplest  of those that change the same, and do it as well, the one that assumes least
near      rivals that change the same and are not beyond chance worse
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Errors, Evidence, block_z
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.searching.hypotheses import Hypothesis
from servo_bench.diagnosis.searching.screening import Screened
from servo_bench.diagnosis.searching.seeking import Found
from sim_rig.effects import find_effect
from sim_rig.effects.effect import Port

ALIKE, ONE_KIND_ALIKE, AS_GOOD = 0.95, 0.9, 0.04
"""Contenders that change the same, and of which none gains so much more, are told apart by how
much they assume: the one with fewer free numbers and the shorter law is taken. Where one refines
the other less likeness is enough."""
RIVAL_Z, LIKE, HARDLY = 3.0, 0.8, 0.01
"""What lies less behind, and changes so much the same, is a near rival; so is what is `ALIKE` and
behind by a smaller share of what is gained, however alike the blocks are in that: scatter shrinks
with the recording's length, and what laws leave out does not. A delay took 0.5 % more than the lag
that it was (z of 5), bristles of 55 urad 0.7 % more than Coulomb friction (z of 15)."""
REFINES = {"pre_sliding": "coulomb", "thermal_friction": "coulomb", "stribeck": "coulomb"}
"""Friction of its own kind that Coulomb friction does nearly as well."""
CLEARLY, BY_CHANCE = 4.0, 2.0
SLIDING_RAD = 1.3e-5
"""Bristles that only slide: how Coulomb friction's own turn is shaped makes as much of a
difference. Of true Coulomb friction they fitted up to 12 urad; true ones of 24 urad fitted 14 on a
recording's beginning and less on all of it, and are Coulomb friction here."""


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
        """Rivals of other effects that change the same, and are not beyond chance worse, or so
        little that no law is exact to that."""
        gained = float(self.base_costs.sum()) - one.total

        def is_near(c: Contender) -> bool:
            like = self.likeness(one, c)
            hardly = c.total - one.total < HARDLY * gained and like > ALIKE
            return hardly or (block_z(one.costs, c.costs) < RIVAL_Z and like > LIKE)

        return tuple(c for c in self.contenders if c.effect != one.effect and is_near(c))


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
    base_costs = all_costs(base.errors, held[0], sigma)
    played = Round(base, held[0], base_costs, sigma, tuple(contenders), screened)
    return replace(played, contenders=_simplest_first(played))


def _simplest_first(played: Round) -> tuple[Contender, ...]:
    """The best one, unless a simpler one does the same as well."""
    best = played.contenders[0]
    gained = float(played.base_costs.sum()) - best.total
    as_good = [c for c in played.contenders if c.total - best.total < AS_GOOD * gained]
    alike = [c for c in as_good if _is_alike(played, best, c)]
    first = min(alike, key=lambda c: _assumes(c.effect)) if alike else best
    return (first, *(c for c in played.contenders if c is not first))


def _is_alike(played: Round, best: Contender, other: Contender) -> bool:
    """Whether they change the same; a plain cause need not, where what refines it is better than it
    by no more than chance."""
    leads_z, refines = block_z(best.costs, other.costs), REFINES.get(best.effect) == other.effect
    if refines and leads_z < BY_CHANCE:
        return True
    enough = played.likeness(best, other) > _least_likeness(best, other)
    return enough and (leads_z < CLEARLY or _bristle_rad(best) < SLIDING_RAD)


def _least_likeness(best: Contender, plain: Contender) -> float:
    return ONE_KIND_ALIKE if REFINES.get(best.effect) == plain.effect else ALIKE


def _bristle_rad(contender: Contender) -> float:
    """How far its friction gives before it slides; infinite of what has no bristles."""
    params = contender.found.model.effects[contender.effect]
    return float(getattr(params, "breakaway_angle_rad", np.inf))


def _assumes(effect: str) -> tuple[int, int, bool]:
    """Memory, parameters, and a place behind the motor: how much a hypothesis assumes."""
    found = find_effect(effect)
    memory = len(found.memory._fields) if found.memory is not None else 0
    return memory, len(found.parameters), found.port is Port.LOAD_TORQUE


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
        costs=all_costs(found.errors, held, sigma),
    )


def all_costs(seen: Errors, held: Errors, sigma: Array) -> Array:
    """Of every block, seen and held out, shape (blocks,)."""
    return np.concatenate([seen.costs(sigma), held.costs(sigma)])
