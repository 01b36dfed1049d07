"""What an experiment can say about each element of the symmetric kernels g1, g2, g3.

identifiable   the element itself
sum only       it is measured together with others, whose sum is known
aliased        another element of the kernels lies on the same shift: no estimator can split them
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from servo_bench.kernels.shifts import element_shifts, lag_sets


class Label(IntEnum):
    """Of one element."""

    IDENTIFIABLE = 0
    SUM_ONLY = 1
    ALIASED = 2


@dataclass(frozen=True, slots=True, eq=False)
class ElementLabels:
    """Labels of g1, g2, g3: shapes (M,), (M, M), (M, M, M), symmetric, as `Label` values."""

    order1: NDArray[np.int8]
    order2: NDArray[np.int8]
    order3: NDArray[np.int8]

    def count(self, label: Label) -> int:
        """How many different elements (each symmetric one once) carry a label."""
        found = int(np.count_nonzero(self.order1 == label))
        for labels in (self.order2, self.order3):
            lags = np.indices(labels.shape)
            once = np.all(np.diff(lags, axis=0) >= 0, axis=0)
            found += int(np.count_nonzero((labels == label) & once))
        return found


def element_labels(
    polynomial: str,
    memory: int,
    order: int = 3,
    *,
    amplitudes: int = 1,
    inverse_repeat: bool = False,
) -> ElementLabels:
    """Labels of every element for a binary M-sequence of that polynomial.

    On one amplitude u^2 is a constant, so g1(i) stands with F(i), g2(i,i) with g0, g3(i,i,i) and
    g3(i,q,q) with g1(i). From two amplitudes on g1 and the even orders stand alone, and of the
    diagonals of order 3 only their sum F(i) is known. With inverse repeat odd and even orders
    cannot meet. ConfigError where the polynomial is not primitive.
    """
    measured = [element_shifts(polynomial, memory, m) for m in range(1, order + 1)]
    groups = [measured[::2], measured[1::2]] if inverse_repeat else [measured]
    shared = {id(shifts): np.zeros(shifts.size, np.bool_) for shifts in measured}
    for group in groups:
        everything, counts = np.unique(
            np.concatenate(group or [measured[0][:0]]), return_counts=True
        )
        crowded = everything[counts > 1]
        for shifts in group:
            shared[id(shifts)] = np.isin(shifts, crowded) | (shifts < 0)
    linear = Label.IDENTIFIABLE if amplitudes > 1 else Label.SUM_ONLY
    labels = [np.full((memory,) * m, Label.SUM_ONLY, np.int8) for m in (1, 2, 3)]
    labels[0][:] = linear if order >= 1 else Label.ALIASED
    for m, shifts in enumerate(measured, start=1):
        sets = lag_sets(memory, m)
        clear = linear if m == 1 else Label.IDENTIFIABLE
        values = np.where(shared[id(shifts)], Label.ALIASED, clear)
        for places in _orderings(m):
            labels[m - 1][tuple(sets[:, places].T)] = values
    return ElementLabels(*labels)


def level_labels(levels: int, memory: int) -> ElementLabels:
    """Labels for a sequence of three or five levels whose terms were fitted without dependence.

    On three u^3 = u, so g1(i) stands with g3(i,i,i); on five every element stands alone.
    """
    labels = [np.full((memory,) * m, Label.IDENTIFIABLE, np.int8) for m in (1, 2, 3)]
    if levels == 3:
        labels[0][:] = Label.SUM_ONLY
        each = np.arange(memory)
        labels[2][each, each, each] = Label.SUM_ONLY
    return ElementLabels(*labels)


def _orderings(order: int) -> list[list[int]]:
    if order == 1:
        return [[0]]
    return [
        [*rest[:place], order - 1, *rest[place:]]
        for rest in _orderings(order - 1)
        for place in range(order)
    ]


def folded_third_order(g3: NDArray[np.float64]) -> NDArray[np.float64]:
    """F(i) = g3(i,i,i) + 3 sum_{q != i} g3(i,q,q) of a symmetric kernel, (M, M, M) -> (M,).

    (Equation 8 of the paper prints the sum over all q, which counts g3(i,i,i) four times.)
    """
    every = np.einsum("iqq->i", g3)
    diagonal = np.einsum("iii->i", g3)
    folded: NDArray[np.float64] = diagonal + 3.0 * (every - diagonal)
    return folded
