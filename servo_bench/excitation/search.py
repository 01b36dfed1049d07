"""Choosing an M-sequence: which polynomial resolves the kernels that are wanted, and best.

The rule is a hard filter (the collision-free memory must reach the one wanted) and then the least
decay-weighted alias of orders 5 and 7: the distance rule alone ranks polynomials hardly better
than chance on what their kernels predict.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import ConfigError
from servo_bench.excitation.enumeration import (
    alias_scores,
    collision_free_memories,
    primitive_polynomials,
)

ORDERS = (2, 3)
LISTED = 10


@dataclass(frozen=True, slots=True)
class Candidate:
    """One polynomial (octal): its collision-free memories, and the alias of orders 5 and 7.

    `memory_inverse_repeat` is that of order 3 played as inverse-repeat sequence, whose odd and even
    orders answer apart.
    """

    polynomial: str
    memory_order2: int
    memory_order3: int
    memory_inverse_repeat: int
    alias_percent: float


@dataclass(frozen=True, slots=True)
class SequenceSearch:
    """What a search found. `candidates`: those that reach the memory, least alias first, ten."""

    degree: int
    memory: int
    order: int
    inverse_repeat: bool
    primitives: int
    reaching: int
    largest_memory: int
    median_memory: float
    candidates: tuple[Candidate, ...]

    @property
    def chips(self) -> int:
        """Of one period (an inverse-repeat period is twice that)."""
        return (1 << self.degree) - 1

    @property
    def recommended(self) -> Candidate:
        """The first."""
        return self.candidates[0]


def search(
    degree: int, memory: int, order: int = 3, *, inverse_repeat: bool = False
) -> SequenceSearch:
    """Every primitive polynomial of a degree, judged for kernels of that memory and order.

    ConfigError for a degree outside 5 to 20, an order outside 2 to 3, or a memory that no
    polynomial of the degree can resolve.
    """
    if order not in ORDERS or memory < 1:
        raise ConfigError(
            f"kernels of order {order} with a memory of {memory} samples cannot be searched for: "
            f"orders 2 and 3, and memories from 1, are supported."
        )
    polynomials = primitive_polynomials(degree)
    mirrored = inverse_repeat and order == max(ORDERS)
    memories = collision_free_memories(polynomials, degree, order, inverse_repeat=mirrored)
    reaching = polynomials[memories >= memory]
    if not reaching.size:
        raise ConfigError(
            f"no primitive polynomial of degree {degree} keeps kernels up to order {order} apart "
            f"in a memory of {memory} samples: the best reaches {memories.max()} (octal "
            f"{polynomials[memories.argmax()]:o}). Take at most that memory, or a higher degree."
        )
    scores = alias_scores(reaching, degree, memory, order=order, inverse_repeat=inverse_repeat)
    best = np.argsort(scores, kind="stable")[:LISTED]
    return SequenceSearch(
        degree=degree,
        memory=memory,
        order=order,
        inverse_repeat=inverse_repeat,
        primitives=int(polynomials.size),
        reaching=int(reaching.size),
        largest_memory=int(memories.max()),
        median_memory=float(np.median(memories)),
        candidates=_candidates(reaching[best], scores[best], degree),
    )


def _candidates(
    polynomials: NDArray[np.int64], scores: NDArray[np.float64], degree: int
) -> tuple[Candidate, ...]:
    order2 = collision_free_memories(polynomials, degree, 2)
    order3 = collision_free_memories(polynomials, degree, 3)
    odd = collision_free_memories(polynomials, degree, 3, inverse_repeat=True)
    rows = zip(polynomials, order2, order3, odd, scores, strict=True)
    return tuple(
        Candidate(f"{int(f):o}", int(m2), int(m3), int(mi), float(score))
        for f, m2, m3, mi, score in rows
    )
