"""Orders told apart by playing more than one binary M-sequence: amplitudes, and inverse repeat.

Several amplitudes A (Vandermonde): on each shift the coefficient is a polynomial in A,

    lag i             c1 = A g1(i) + A^3 F(i) [+ A^5 ...]        powers 1, 3, ...
    lags i < j        c2 = 2 A^2 g2(i,j) [+ A^4 ...]             powers 2, 4, ...
    lags i < j < k    c3 = 6 A^3 g3(i,j,k) [+ A^5 ...]           powers 3, 5, ...

so k amplitudes separate k powers of a parity: g1 from F (never the single g3(i,q,q)), and the
lower orders from the aliases of the higher. It interpolates in A; beyond it explodes.

Inverse repeat, u'(t) = (-1)^t u(t), period 2 N: half the difference of y(t) and y(t + N) has
the odd orders alone, half the sum the even ones. With s(S) = (-1)^(sum of lags)

    (-1)^t odd(t) = sum s(S) c_S u(t - k(S))        even(t) = c0 + sum s(S) c_S u(t - k(S))

and each is extracted for itself: odd and even elements can no longer meet.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import FitError
from servo_bench.excitation.msequence import m_sequence
from servo_bench.kernels.volterra import (
    Kernels,
    check_memory,
    extract,
    extract_orders,
)

Array = NDArray[np.float64]

LARGEST_CONDITION = 1e4


@dataclass(frozen=True, slots=True, eq=False)
class SeparatedKernels:
    """Kernels that no amplitude is mixed into any more, at most up to the separated powers.

    g0, g1 (M,), folded (F, (M,)), g2 (M, M) and g3 (M, M, M), nonzero for ascending lags, as
    symmetric-kernel values. `condition` is that of the Vandermonde systems (the larger);
    `errors` the standard error of g1, F, g2, g3 by the scatter of the empty shifts.
    """

    amplitudes: tuple[float, ...]
    g0: float
    g1: Array
    folded: Array
    g2: Array
    g3: Array
    condition: float
    errors: tuple[float, float, float, float]


def separate_amplitudes(
    responses: Array, amplitudes: tuple[float, ...], polynomial: str, memory: int
) -> SeparatedKernels:
    """From one (mean) period at each amplitude, shape (k, N), in steady state.

    FitError with fewer than two different amplitudes, with levels too close to be told apart, or
    where `extract` refuses.
    """
    levels = np.asarray(amplitudes, np.float64)
    if levels.size != len(responses) or np.unique(np.abs(levels)).size < 2:
        raise FitError(
            f"{len(responses)} responses to amplitudes {amplitudes} were given: orders are "
            f"separated by one period at each of two or more different amplitudes."
        )
    kernels = [
        extract(response, polynomial, float(level), memory)
        for response, level in zip(responses, levels, strict=True)
    ]
    odd, even = _powers(levels, 1), _powers(levels, 2)
    higher = _powers(levels, 3)
    constant = np.hstack([np.ones((levels.size, 1)), even[:, : levels.size - 1]])
    condition = max(_condition(system) for system in (odd, even, higher, constant))
    if condition > LARGEST_CONDITION:
        raise FitError(
            f"amplitudes {amplitudes} are too many or too close: separating their powers has the "
            f"condition {condition:.0f} (at most {LARGEST_CONDITION:.0f}). Spread them over a "
            f"factor of two or more, or use fewer."
        )
    linear = _solved(odd, [k.c1 for k in kernels])
    scatter = float(np.max([k.scatter for k in kernels]))
    gains = [np.linalg.norm(np.linalg.pinv(s), axis=1) for s in (odd, even, higher)]
    return SeparatedKernels(
        amplitudes=tuple(levels.tolist()),
        g0=float(_solved(constant, [np.array([k.constant]) for k in kernels])[0, 0]),
        g1=linear[0],
        folded=linear[1],
        g2=_solved(even, [k.c2 for k in kernels])[0] / 2.0,
        g3=_solved(higher, [k.c3 for k in kernels])[0] / 6.0,
        condition=condition,
        errors=(
            scatter * float(gains[0][0]),
            scatter * float(gains[0][1]),
            scatter * float(gains[1][0]) / 2.0,
            scatter * float(gains[2][0]) / 6.0,
        ),
    )


def _powers(levels: Array, lowest: int) -> Array:
    """A^lowest, A^(lowest + 2), ...: as many as there are levels, shape (k, k)."""
    return np.asarray(levels[:, None] ** (lowest + 2 * np.arange(levels.size)))


def _condition(system: Array) -> float:
    """Of the system with its columns scaled to one length: what no choice of units can mend."""
    return float(np.linalg.cond(system / np.linalg.norm(system, axis=0)))


def _solved(system: Array, measured: list[Array]) -> Array:
    """The powers' coefficients, shape (powers, ...)."""
    stacked = np.stack(measured)
    solved = np.linalg.lstsq(system, stacked.reshape(len(stacked), -1), rcond=None)[0]
    return np.asarray(solved, np.float64).reshape(-1, *stacked.shape[1:])


def extract_inverse_repeat(
    response: Array, polynomial: str, amplitude: float, memory: int, *, period_s: float = 1.0
) -> Kernels:
    """Kernels from whole inverse-repeat periods in steady state, shape (2 N,) or (periods, 2 N).

    FitError for another shape or where `extract` refuses.
    """
    chips = m_sequence(polynomial).size
    periods = np.atleast_2d(np.asarray(response, np.float64))
    if periods.ndim != 2 or periods.shape[1] != 2 * chips:
        raise FitError(
            f"the response has shape {np.shape(response)}: an inverse-repeat period of "
            f"{polynomial} has {2 * chips} samples. Cut the response to whole periods."
        )
    first, second = periods[:, :chips], periods[:, chips:]
    signs = 1.0 - 2.0 * (np.arange(chips) % 2)
    check_memory(polynomial, memory, inverse_repeat=True)
    asked = (polynomial, amplitude, memory)
    odd = extract_orders(signs * (first - second) / 2.0, *asked, (1, 3), period_s=period_s)
    even = extract_orders((first + second) / 2.0, *asked, (2,), period_s=period_s)
    lag_sign = 1.0 - 2.0 * (np.arange(memory) % 2)
    errors = (odd.standard_error, even.standard_error)
    known = [error for error in errors if error is not None]
    return Kernels(
        polynomial=polynomial,
        amplitude=amplitude,
        memory=memory,
        order=3,
        period_s=period_s,
        periods=odd.periods,
        baseline=even.baseline,
        constant=even.constant,
        c1=odd.c1 * lag_sign,
        c2=even.c2 * np.multiply.outer(lag_sign, lag_sign),
        c3=odd.c3 * np.einsum("i,j,k->ijk", lag_sign, lag_sign, lag_sign),
        scatter=max(odd.scatter, even.scatter),
        scatter_rms=max(odd.scatter_rms, even.scatter_rms),
        scatter_kurtosis=max(odd.scatter_kurtosis, even.scatter_kurtosis),
        standard_error=max(known) if known else None,
    )
