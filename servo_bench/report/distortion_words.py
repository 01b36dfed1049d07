"""What kind of nonlinearity a rig shows, in words that assume no model of it.

The response's variance by order: an odd order comes from what is alike in both directions, an even
one from what is not. An order is shown where its energy is more than its scatter would have.
"""

from math import comb, sqrt

import numpy as np

from servo_bench.kernels.analysis import Analysis
from servo_bench.report.wording import small_percent

DEVIATIONS = 4.0
"""How far above its expectation the energy of mere scatter is not believed to lie."""

ODD = (
    "odd: backlash, friction that is alike in both directions, compliance that stiffens, and "
    "saturation are of this kind"
)
EVEN = (
    "even: something differs between the directions, as a bias, gravity, one-sided friction, or a "
    "drive's offset"
)
OR_ALIASES = (
    " (or aliases of orders from 5 on, which one M-sequence has and an inverse-repeat sequence has "
    "not)"
)

ALIKE = "No difference between the directions stands out of the scatter."


def scatter_percent(analysis: Analysis, order: int) -> float:
    """The energy share that coefficients of nothing but scatter would have."""
    kernels = analysis.kernels
    energy = comb(kernels.memory, order) * kernels.scatter_rms**2
    return 100.0 * energy / float(np.var(analysis.identification.measured))


def shown(analysis: Analysis, order: int) -> bool:
    """Whether an order's energy is more than scatter."""
    elements = comb(analysis.kernels.memory, order)
    if not elements:
        return False
    spread = sqrt((analysis.kernels.scatter_kurtosis - 1.0) / elements)
    likely = scatter_percent(analysis, order) * (1.0 + DEVIATIONS * spread)
    return analysis.energy_percent[order - 1] > likely


def noise_percent(analysis: Analysis) -> tuple[float, str]:
    """Share of noise in the (mean) period's variance, and how it was told."""
    variance = float(np.var(analysis.identification.measured))
    periods = analysis.kernels.periods
    if np.isfinite(analysis.repeat_noise_rad_s):
        mean = analysis.repeat_noise_rad_s**2 / periods
        return 100.0 * mean / variance, f"by the spread between {periods} periods"
    return 100.0 * analysis.noise_rad_s**2 / variance / periods, "by the standstill"


def distortion_sentences(analysis: Analysis) -> list[str]:
    """The statement: kind, levels, and what is left."""
    linear, even, odd = analysis.energy_percent
    odd_shown, even_shown = shown(analysis, 3), shown(analysis, 2)
    apart = analysis.played.kind == "inverse-repeat"
    even_words = EVEN if apart else f"{EVEN}{OR_ALIASES}"
    match odd_shown, even_shown:
        case True, True:
            kind = f"The nonlinearity is both {ODD}; and {even_words}."
        case True, False:
            kind = f"The nonlinearity is {ODD}. {ALIKE}"
        case False, True:
            kind = f"The nonlinearity is {even_words}. Nothing odd is seen."
        case _:
            kind = "No nonlinearity of order 2 or 3 stands out of the scatter."
    levels = (
        f"Linear {small_percent(linear)}; even (order 2) {_level(analysis, 2, even, linear)}; "
        f"odd (order 3) {_level(analysis, 3, odd, linear)}."
    )
    noise, source = noise_percent(analysis)
    rest = max(0.0, 100.0 - linear - even - odd)
    left = (
        f"In none of these are {small_percent(rest)}: orders from 5 on, memory beyond "
        f"{analysis.kernels.memory} samples, and noise"
    )
    floor = f" ({small_percent(noise)} {source})" if np.isfinite(noise) else " (not known)"
    sentences = [kind, levels, f"{left}{floor}."]
    if abs(analysis.bias_rad_s) > 1e-3 * analysis.kernels.amplitude:
        sentences.append(
            "The sequence carried a bias, about which an odd law has even orders too: only without "
            "a bias do even orders tell the directions apart."
        )
    return sentences


def _level(analysis: Analysis, order: int, energy: float, linear: float) -> str:
    distortion = 100.0 * sqrt(max(energy, 0.0) / linear) if linear > 0.0 else float("nan")
    return (
        f"{small_percent(energy)}, a distortion of {distortion:.2g} % of the linear answer, where "
        f"scatter alone gives {small_percent(scatter_percent(analysis, order))}"
    )
