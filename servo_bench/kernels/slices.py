"""The slices of the kernels in a sequence's correlation, and what it can tell, in words.

A slice holds the elements with the same differences of lags. It is a contiguous run of shifts,
M - d long, d the largest difference.
"""

from dataclasses import dataclass

import numpy as np

from servo_bench.excitation.msequence import checked_polynomial, m_sequence
from servo_bench.kernels.labels import Label, element_labels
from servo_bench.kernels.shifts import collision_free_memory, lag_sets, shifts_of


@dataclass(frozen=True, slots=True)
class Slice:
    """Elements of lags (t, t + d1, t + d2, ...), from t = 0 at `first_shift` on, `length` long."""

    order: int
    differences: tuple[int, ...]
    first_shift: int
    length: int


def sequence_slices(polynomial: str, memory: int, order: int = 3) -> tuple[Slice, ...]:
    """Every slice up to an order. ConfigError where the polynomial is not primitive."""
    checked_polynomial(polynomial)
    found = []
    for m in range(1, order + 1):
        sets = lag_sets(memory, m)
        first = sets[sets[:, 0] == 0]
        for lags, shift in zip(first.tolist(), shifts_of(polynomial, first).tolist(), strict=True):
            found.append(Slice(m, tuple(lags[1:]), shift, memory - lags[-1]))
    return tuple(found)


def described(
    polynomial: str, memory: int, order: int = 3, *, inverse_repeat: bool = False
) -> list[str]:
    """What the sequence can and cannot identify, as sentences. ConfigError if not primitive."""
    chips = m_sequence(polynomial).size
    labels = element_labels(polynomial, memory, order, inverse_repeat=inverse_repeat)
    aliased = labels.count(Label.ALIASED)
    elements = sum(lag_sets(memory, m).shape[0] for m in range(1, order + 1))
    limits = {
        m: collision_free_memory(polynomial, m, inverse_repeat=inverse_repeat) for m in (2, 3)
    }
    said = [
        f"{polynomial} (octal) has a period of {chips} chips; its slices stay apart up to a memory "
        f"of {limits[2]} for order 2 and {limits[3]} for order 3.",
        f"In a memory of {memory}, {elements} elements up to order {order} lie on "
        f"{_occupied(polynomial, memory, order)} shifts; {aliased} of them share a shift with "
        f"another one.",
    ]
    if aliased:
        said.append(
            "ALIASED: elements that share a shift have equal regressors, so no estimator can tell "
            f"them apart. Use a memory of at most {limits.get(order, chips)}, or a higher degree."
        )
    said.append(
        "Identifiable at one amplitude: the elements of orders 2 and 3 whose lags all differ. Only "
        "as sums: g2(i,i) within the constant; g3(i,i,i) and g3(i,q,q) within g1(i). Two "
        "amplitudes tell g1 from that sum; three or five levels (field sequences) show diagonals."
    )
    if inverse_repeat:
        said.append("Played as inverse repeat, odd and even orders cannot alias into each other.")
    said.append(
        "Orders 5 and above alias too, spread over all shifts: see the score of `sequence search`."
    )
    return said


def _occupied(polynomial: str, memory: int, order: int) -> int:
    shifts = [shifts_of(polynomial, lag_sets(memory, m)) for m in range(1, order + 1)]
    return int(np.unique(np.concatenate(shifts)).size)
