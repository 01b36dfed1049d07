"""A trial from a seed: which rig, what is hidden in it, and what a verdict on it should say.

    asked(seed)              the trial of this seed, a value: the same one every time
    asked(seed, kind)        the same seed with this kind

    null        nothing is hidden: "none"
    one         one cause of the catalogue of effects
    pair        two of them, of different groups
    outside     one that the catalogue lacks: "unknown"

How large a cause may be is in `hiding`.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from tests.third.hiding import (
    BY_NAME,
    IN_THE_CATALOGUE,
    OUTSIDE_THE_CATALOGUE,
    Expected,
    Hidden,
    Hiding,
)
from tests.third.recorded import Start, World
from tests.third.rigs import RIGS, Rig, built

Kind = Literal["null", "one", "pair", "outside"]
SHARES: dict[Kind, float] = {"null": 0.2, "one": 0.5, "pair": 0.15, "outside": 0.15}
STARTS_WITHIN_RAD, PLACES = 0.4, 0.4


@dataclass(frozen=True, slots=True)
class Trial:
    """A trial: the rig as it is built, and what is hidden in it."""

    seed: int
    kind: Kind
    rig: Rig
    plain: World
    hidden: tuple[Hidden, ...]
    take_seeds: tuple[int, int]
    starts: tuple[Start, Start]

    @property
    def world(self) -> World:
        """The rig with everything hidden in it."""
        world = self.plain
        for hidden in self.hidden:
            world = BY_NAME[hidden.effect].change(world, hidden)
        return world

    @property
    def expected(self) -> tuple[Expected, ...]:
        """What a verdict should say; nothing where none of it is in the catalogue."""
        if self.kind == "outside":
            return ()
        world = self.world
        return tuple(BY_NAME[h.effect].expected(self.rig, world, h) for h in self.hidden)


def asked(seed: int, kind: Kind | None = None) -> Trial:
    """The trial of a seed. ValueError for a kind that there is not."""
    rng = np.random.default_rng((seed, 3))
    drawn: Kind = get_args(Kind)[int(rng.choice(len(SHARES), p=list(SHARES.values())))]
    kind = drawn if kind is None else kind
    if kind not in SHARES:
        raise ValueError(f"kind {kind!r}: give one of {', '.join(SHARES)}")
    rig = RIGS[int(rng.integers(len(RIGS)))] if kind == "null" else None
    hidings = _chosen(kind, rng)
    if rig is None:
        fit = [rig for rig in RIGS if all(h.is_for(rig) for h in hidings)]
        rig = fit[int(rng.integers(len(fit)))]
    plain = World(built(rig, rng))
    hidden = tuple(hiding.drawn(rig, rng) for hiding in hidings)
    take_seeds = (int(rng.integers(1 << 31)), int(rng.integers(1 << 31)))
    places = rng.uniform(-PLACES, PLACES, 2)
    later_rad = float(rng.uniform(-STARTS_WITHIN_RAD, STARTS_WITHIN_RAD))
    starts = (Start(0.0, float(places[0])), Start(later_rad, float(places[1])))
    return Trial(seed, kind, rig, plain, hidden, take_seeds, starts)


def _chosen(kind: Kind, rng: np.random.Generator) -> tuple[Hiding, ...]:
    """What to hide; of a pair two of different groups that some rig can have both of."""
    if kind == "null":
        return ()
    table = OUTSIDE_THE_CATALOGUE if kind == "outside" else IN_THE_CATALOGUE
    first = table[int(rng.integers(len(table)))]
    if kind != "pair":
        return (first,)
    others = [h for h in table if h.group != first.group and set(h.rigs) & set(first.rigs)]
    return (first, others[int(rng.integers(len(others)))])
