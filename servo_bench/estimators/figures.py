"""Kernels as a report draws them: g1 with its band, sections of g2 and g3, energies by order.

They are read off the regularised posterior. Energies are shares of the response's variance on
random binary input:

    linear   order 1           even   order 2 (and 4, 6)         odd   order 3 (5, 7)
    noise    the posterior's

A play alone is odd; friction that differs between directions, or a bias, is even.
"""

from dataclasses import dataclass

import numpy as np

from servo_bench.estimators.data import Array
from servo_bench.estimators.elementary import elementary_sums
from servo_bench.estimators.regularised import MultilinearPosterior
from servo_bench.kernels.shifts import lag_sets

BAND_DEVIATIONS = 1.96
"""A band of 95 %."""


@dataclass(frozen=True, slots=True)
class OrderEnergies:
    """Percent of the response's variance. NaN where it is not known; `rest` is what is left."""

    linear_percent: float
    even_percent: float
    odd_percent: float
    noise_percent: float

    @property
    def rest_percent(self) -> float:
        """Neither kernels nor noise: orders that were not modelled."""
        known = (self.linear_percent, self.even_percent, self.odd_percent, self.noise_percent)
        return 100.0 - float(np.nansum(known))


@dataclass(frozen=True, slots=True, eq=False)
class KernelFigures:
    """g1 and its 95 % band, shapes (M,); g2 (M, M) and g3 (M, M, M), symmetric, NaN on diagonals.

    Units: response per command, per command squared, per command cubed. `lags_s` in seconds.
    """

    lags_s: Array
    g1: Array
    g1_low: Array
    g1_high: Array
    g2: Array
    g3: Array
    energies: OrderEnergies

    def g3_section(self, lag: int) -> Array:
        """g3(., ., lag), shape (M, M)."""
        section: Array = self.g3[:, :, lag]
        return section


def posterior_figures(
    posterior: MultilinearPosterior, response_variance: float, period_s: float
) -> KernelFigures:
    """Of the regularised posterior, whose band narrows where the prior expects nothing."""
    memory, amplitude = posterior.memory, posterior.amplitude
    mean, deviation = posterior.element(1)
    matrices = []
    for order, factorial in ((2, 2.0), (3, 6.0)):
        matrix = np.full((memory,) * order, np.nan)
        sets = lag_sets(memory, order)
        values = posterior.element(order)[0] / (factorial * amplitude**order)
        for places in ([0, 1], [1, 0]) if order == 2 else _SIX:
            matrix[tuple(sets[:, places].T)] = values
        matrices.append(matrix)
    return KernelFigures(
        lags_s=np.arange(memory, dtype=np.float64) * period_s,
        g1=mean / amplitude,
        g1_low=(mean - BAND_DEVIATIONS * deviation) / amplitude,
        g1_high=(mean + BAND_DEVIATIONS * deviation) / amplitude,
        g2=matrices[0],
        g3=matrices[1],
        energies=_posterior_energies(posterior, response_variance),
    )


_SIX = ([0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0])


def _posterior_energies(posterior: MultilinearPosterior, variance: float) -> OrderEnergies:
    """Each shift's coefficient, shared among the orders as the prior expects them there."""
    spectrum, prior = posterior.spectrum, posterior.prior
    lags = spectrum.lags(posterior.memory)
    whole = prior.shift_variances(spectrum, lags)
    shrunk = (posterior.coefficients / whole) ** 2
    groups = {"linear": 0.0, "even": 0.0, "odd": 0.0}
    for weights, order in zip(prior.weights, prior.orders, strict=True):
        places = elementary_sums(lags, weights[None, :], np.array([order]))
        share = np.maximum(spectrum.shifts_of(places), 0.0)
        name = "linear" if order == 1 else ("odd" if order % 2 else "even")
        groups[name] += 100.0 * float(np.sum(share * whole * shrunk)) / variance
    noise = 100.0 * posterior.parameters["noise"].value ** 2 / variance
    return OrderEnergies(groups["linear"], groups["even"], groups["odd"], noise)
