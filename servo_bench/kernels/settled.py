"""Whether a response forgets: a velocity does, an angle sums up everything that ever was.

The correlation of an M-sequence with an angle is a sawtooth over the whole period. Aliases of
higher orders are runs no longer than the memory; a sixteenth of the period away they have
forgotten each other, and an angle has not.
"""

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import FitError

LIKENESS, SHARE = 0.5, 0.05
"""A sixteenth of a period apart, beyond both of these, a response is summed, not settled."""

SHORTEST = 512
"""Chips of a period from which that can be told."""


def refuse_integrator(
    coefficients: NDArray[np.float64], empty: NDArray[np.bool_], largest: float
) -> None:
    """Raise FitError where the empty shifts, shape (N,), hold a sawtooth.

    `largest` is the largest linear coefficient.
    """
    apart = coefficients.size // 16
    both = empty & np.roll(empty, -apart)
    if coefficients.size < SHORTEST or np.count_nonzero(both) < coefficients.size // 4:
        return
    here, there = coefficients[both], np.roll(coefficients, -apart)[both]
    spread = float(np.sqrt(np.mean(here**2)))
    likeness = float(np.mean(here * there)) / max(spread**2, np.finfo(float).tiny)
    if likeness > LIKENESS and spread > SHARE * largest:
        raise FitError(
            f"the response does not forget: where no kernel element can lie its correlation is "
            f"{100.0 * spread / largest:.0f} % of the largest linear one, and still alike {apart} "
            f"samples apart. This is an angle (a velocity summed up) or a drift. Give velocities: "
            f"the increments of the angle over the period."
        )
