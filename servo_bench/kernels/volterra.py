"""Volterra kernels up to order 3, measured with one period or more of a binary M-sequence.

On chips u = +-1 (the command is A u) every kernel is multilinear, for u^2 = 1:

    y(t) = c0 + sum_i c1(i) u(t-i) + sum_{i<j} c2(i,j) u(t-i) u(t-j)
              + sum_{i<j<k} c3(i,j,k) u(t-i) u(t-j) u(t-k)

and in the symmetric kernels of the discrete Volterra series, lags in chips,

    c0 = g0 + A^2 sum_i g2(i,i)      c1(i) = A g1(i) + A^3 F(i)
    c2(i,j) = 2 A^2 g2(i,j)          c3(i,j,k) = 6 A^3 g3(i,j,k)
    F(i) = g3(i,i,i) + 3 sum_{q != i} g3(i,q,q)

(the sum of equation 8 of the paper is over q != tau: as printed it counts g3(i,i,i) four times).
What one amplitude identifies is c0, c1, c2, c3, and so g2 and g3 off their diagonals. g2(i,i),
g3(i,i,i) and g3(i,q,q) are not identifiable, hence neither is F, and g1 only as g1 + A^2 F. Odd
orders from 5 on fold into orders 1 and 3 likewise. Predicting binary input of the same amplitude
needs only the c: nothing is to be subtracted. The kernels hold at that amplitude alone.

A kernel in the paper's continuous time is ours of order m divided by period_s^m.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import FitError
from servo_bench.kernels.correlate import averaged_correlation
from servo_bench.kernels.settled import refuse_integrator
from servo_bench.kernels.shifts import (
    ORDERS,
    collision_free_memory,
    element_shifts,
    lag_sets,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Kernels:
    """What one M-sequence measured. Units: those of the response, unless said otherwise.

    polynomial      octal, characteristic, highest power first
    amplitude       A, the command that one chip stands for
    memory          M, lags 0 to M - 1
    order           1, 2 or 3; coefficients of higher orders are zero and not measured
    period_s        between two chips
    periods         how many periods were averaged
    baseline        of the cross-correlation: its median over the shifts that hold no element
    constant        c0
    c1              shape (M,)
    c2              shape (M, M), zero but for i < j
    c3              shape (M, M, M), zero but for i < j < k
    scatter         spread of a coefficient, from the empty shifts (1.4826 median |phi - baseline|):
                    noise and aliases of orders 5 and above together
    scatter_rms     root of their mean square: larger, for the aliases are few and large
    scatter_kurtosis  of their distribution, 3 for a normal one: how surely an order's energy can be
                    held against scatter_rms
    standard_error  of every coefficient, from the spread between periods: noise alone; None
                    where a single period was measured
    levels          how many the chips had: 2, or 3 and 5, whose c2 and c3 have diagonals (`levels`)
    """

    polynomial: str
    amplitude: float
    memory: int
    order: int
    period_s: float
    periods: int
    baseline: float
    constant: float
    c1: Array
    c2: Array
    c3: Array
    scatter: float
    scatter_rms: float
    scatter_kurtosis: float
    standard_error: float | None
    levels: int = 2

    @property
    def lags_s(self) -> Array:
        """The time of each lag; shape (M,)."""
        return np.arange(self.memory, dtype=np.float64) * self.period_s

    @property
    def g1(self) -> Array:
        """g1(i) + A^2 F(i), which one amplitude cannot take apart; response per command, (M,)."""
        g1: Array = self.c1 / self.amplitude
        return g1

    @property
    def g2_matrix(self) -> Array:
        """g2, symmetric, (M, M); NaN on its diagonal, which binary input cannot identify."""
        matrix = np.asarray((self.c2 + self.c2.T) / (2.0 * self.amplitude**2))
        if self.levels == 2:
            np.fill_diagonal(matrix, np.nan)
        return matrix

    def g2(self, i: int, j: int) -> float:
        """g2(i, j) = c2 / (2 A^2), lags in any order; NaN where they are equal."""
        return float(self.g2_matrix[i, j])

    def g3(self, i: int, j: int, k: int) -> float:
        """g3(i, j, k) = c3 / (6 A^3), lags in any order; NaN where two of them are equal."""
        return float(self.g3_section(k)[i, j])

    def g3_section(self, tau3: int) -> Array:
        """The cross-section g3(., ., tau3), symmetric, (M, M).

        NaN wherever two lags are equal (the diagonal, row tau3 and column tau3), which binary input
        cannot identify; on three levels where all three are.
        """
        half = self.c3[:, :, tau3] + self.c3[:, tau3, :] + self.c3[tau3, :, :]
        section: Array = (half + half.T) / (6.0 * self.amplitude**3)
        if self.levels == 2:
            np.fill_diagonal(section, np.nan)
            section[tau3, :] = np.nan
            section[:, tau3] = np.nan
        elif self.levels == 3:
            section[tau3, tau3] = np.nan
        return section

    @property
    def energies(self) -> Array:
        """The variance that each order 0 to 3 puts into the response to random binary input.

        E_m = sum c_m^2 (order 0 has none); shape (4,), response squared. The elements' scatter is
        in it: number of elements x scatter_rms^2. Diagonals fold into the order that they have
        there.
        """
        repeated = np.einsum("iik->k", self.c3) + np.einsum("ikk->i", self.c3)
        linear = self.c1 + repeated - np.einsum("iii->i", self.c3)
        apart = [self.c2, self.c3]
        if self.levels > 2:
            lags = np.indices(self.c3.shape)
            apart = [np.triu(self.c2, 1), self.c3 * np.all(np.diff(lags, axis=0) > 0, axis=0)]
        return np.array([0.0, *(float(np.sum(c**2)) for c in (linear, *apart))])


def extract(
    response_periods: Array,
    polynomial: str,
    amplitude: float,
    memory: int,
    order: int = 3,
    *,
    period_s: float = 1.0,
) -> Kernels:
    """Kernels from the response to whole periods of the M-sequence, in its periodic steady state.

    `response_periods` has shape (N,) or (periods, N); sample t is the response that chip t can
    reach first. ConfigError where the polynomial is not primitive; FitError where the memory is
    beyond the collision-free one or the response is not finite or not whole periods.
    """
    check_memory(polynomial, memory, order)
    return extract_orders(
        *(response_periods, polynomial, amplitude, memory), ORDERS[:order], period_s=period_s
    )


def extract_orders(
    response_periods: Array,
    polynomial: str,
    amplitude: float,
    memory: int,
    orders: tuple[int, ...],
    *,
    period_s: float,
) -> Kernels:
    """As `extract`, for a response in which these orders are alone, within a memory that was
    checked; the others are zero."""
    correlation = averaged_correlation(response_periods, polynomial)
    order = max(orders)
    elements = {m: element_shifts(polynomial, memory, m) for m in orders}
    empty = np.ones(correlation.phi.size, np.bool_)
    for shifts in elements.values():
        empty[shifts] = False
    if not empty.any():
        raise FitError(
            f"no shift of {polynomial} is empty with memory {memory} and order {order}, so the "
            f"baseline cannot be told. Use a smaller memory or a polynomial of a higher degree."
        )
    # phi = (1 + 1/N) c - (sum c + c0)/N: the median of the empty shifts is the second term.
    baseline = float(np.median(correlation.phi[empty]))
    whole = correlation.phi.size / (correlation.phi.size + 1.0)
    c = (correlation.phi - baseline) * whole
    if 1 in elements:
        refuse_integrator(c, empty, float(np.abs(c[elements[1]]).max()))
    coefficients = [np.zeros((memory,) * m) for m in ORDERS]
    for m, shifts in elements.items():
        coefficients[m - 1][tuple(lag_sets(memory, m).T)] = c[shifts]
    for array in coefficients:
        array.setflags(write=False)
    error = correlation.standard_error
    return Kernels(
        polynomial=polynomial,
        amplitude=amplitude,
        memory=memory,
        order=order,
        period_s=period_s,
        periods=correlation.periods,
        baseline=baseline,
        constant=(correlation.mean - baseline) * whole,
        c1=coefficients[0],
        c2=coefficients[1],
        c3=coefficients[2],
        scatter=float(1.4826 * np.median(np.abs(c[empty]))),
        scatter_rms=float(np.sqrt(np.mean(c[empty] ** 2))),
        scatter_kurtosis=_kurtosis(c[empty]),
        standard_error=None if error is None else error * whole,
    )


def _kurtosis(values: Array) -> float:
    square = float(np.mean(values**2))
    return float(np.mean(values**4)) / square**2 if square > 0.0 else 3.0


def check_memory(
    polynomial: str, memory: int, order: int = max(ORDERS), *, inverse_repeat: bool = False
) -> None:
    """FitError for a memory in which an M-sequence, or what is played of it as an inverse repeat,
    cannot tell elements apart."""
    if order not in ORDERS:
        raise FitError(f"kernels of order {order} were asked for: orders {ORDERS} are measured.")
    if memory < 1:
        raise FitError(f"the kernels' memory is {memory} samples: give at least 1.")
    limit = collision_free_memory(polynomial, order, inverse_repeat=inverse_repeat)
    if memory > limit:
        raise FitError(
            f"memory {memory} is beyond what {polynomial} can resolve up to order {order}: from "
            f"{limit + 1} samples on, different kernel elements fall on the same shift and no "
            f"estimator can tell them apart. Use a memory of at most {limit}, a lower order, or a "
            f"polynomial of a higher degree."
        )
