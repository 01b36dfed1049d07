"""The kernels as figures: the first over its lags, the second as maps, a section of the third.

An experiment's kernels of order m are shown as m! A^m g_m in deg/s, the height of their term in
the response to u = +-1, so that the orders compare; a simulation's as they are. Cells that binary
input cannot identify (two lags alike) are grey with a cross.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from servo_bench.estimators.figures import KernelFigures
from servo_bench.kernels.separation import SeparatedKernels
from servo_bench.kernels.volterra import Kernels
from servo_bench.report.style import (
    ACTUAL,
    BAND,
    MUTED,
    ORDER_1,
    ORDER_3,
    SIGNED_MAP,
    UNKNOWN,
    caption_axes,
    symmetric_limit,
)

Array = NDArray[np.float64]
TAU_3 = 1
"""The cross-section that the paper shows."""
MARKED = 0.1
"""Cells below minus this share of the scale carry a minus sign."""


@dataclass(frozen=True, slots=True)
class Shown:
    """How kernels are written: `response` scales the response's unit, `unit` names the result.

    With `as_terms`, g_m is drawn as m! A^m g_m, the height of its term.
    """

    response: float
    unit: str
    time_scale: float
    time_unit: str
    as_terms: bool

    def factor(self, kernels: Kernels, order: int) -> float:
        """What a kernel of that order is multiplied with to be drawn."""
        term = math.factorial(order) * kernels.amplitude**order if self.as_terms else 1.0
        return term * self.response

    def name(self, order: int) -> str:
        """The quantity that is drawn."""
        g = f"g{'₀₁₂₃'[order]}"
        power = "" if order == 1 else "⁰¹²³"[order]
        factorial = "" if order == 1 else f"{math.factorial(order)} "
        return f"{factorial}A{power} {g}" if self.as_terms else g

    def label(self, order: int) -> str:
        """The quantity and its unit, for an axis."""
        return f"{self.name(order)} ({self.unit})"


EXPERIMENT = Shown(180.0 / math.pi, "deg/s", 1e3, "ms", as_terms=True)
SIMULATION = Shown(1.0, "1", 1.0, "s", as_terms=False)


def draw_first_kernel(
    axes: Axes,
    kernels: Kernels,
    shown: Shown,
    title: str = "",
    posterior: KernelFigures | None = None,
) -> None:
    """g1 over its lags, with +-2 scatter; beside A g1 also g1 itself, which has no unit.

    With a posterior also its mean and band.
    """
    lags = kernels.lags_s * shown.time_scale
    c1 = kernels.g1 * shown.factor(kernels, 1)
    scatter = 2.0 * kernels.scatter * shown.response
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    axes.fill_between(lags, c1 - scatter, c1 + scatter, color=BAND, linewidth=0.0, zorder=1)
    axes.plot(lags, c1, color=ORDER_3, marker="o", markersize=3.2, label="correlation")
    if posterior is not None:
        _draw_posterior(axes, posterior, shown.time_scale, shown.factor(kernels, 1))
        axes.legend(loc="upper right")
    caption_axes(axes, title, f"τ ({shown.time_unit})", shown.label(1))
    if shown.as_terms:
        per_command = shown.factor(kernels, 1)
        right = axes.secondary_yaxis(
            "right",
            functions=(
                lambda y: np.asarray(y, np.float64) / per_command,
                lambda y: np.asarray(y, np.float64) * per_command,
            ),
        )
        right.set_ylabel("g₁ (1)")


def _draw_posterior(axes: Axes, posterior: KernelFigures, time_scale: float, factor: float) -> None:
    lags = posterior.lags_s * time_scale
    low, high = factor * posterior.g1_low, factor * posterior.g1_high
    axes.fill_between(lags, low, high, color=ORDER_1, alpha=0.35, linewidth=0.0, zorder=2)
    axes.plot(
        lags,
        factor * posterior.g1,
        color=ORDER_1,
        linestyle="--",
        linewidth=0.9,
        label="regularised, 95 %",
    )


def draw_separated(axes: Axes, separated: SeparatedKernels, kernels: Kernels, shown: Shown) -> None:
    """A g1 and A^3 F at the kernels' amplitude, with +-2 standard errors."""
    lags = kernels.lags_s * shown.time_scale
    amplitude, scale = kernels.amplitude, shown.response
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    for values, error, power, colour, label in (
        (separated.g1, separated.errors[0], 1, ORDER_3, "A g₁"),
        (separated.folded, separated.errors[1], 3, ORDER_1, "A³ F"),
    ):
        factor = scale * amplitude**power
        axes.fill_between(
            lags,
            factor * (values - 2.0 * error),
            factor * (values + 2.0 * error),
            color=colour,
            alpha=0.25,
            linewidth=0.0,
        )
        axes.plot(lags, factor * values, color=colour, marker="o", markersize=3.0, label=label)
    axes.legend(loc="upper right")
    caption_axes(axes, "", f"τ ({shown.time_unit})", shown.unit)


def draw_second_kernel(figure: Figure, kernels: Kernels, shown: Shown, limit: float) -> None:
    """g2 twice: on the third kernel's colour scale, and on its own."""
    left, right = figure.subplots(1, 2)
    g2 = kernels.g2_matrix * shown.factor(kernels, 2)
    own = symmetric_limit(g2)
    for axes, scale, title in (
        (left, limit, f"on the colour scale of Figure 9: ±{limit:.3g} {shown.unit}"),
        (right, own, f"on its own scale: ±{own:.2g} {shown.unit}"),
    ):
        image = _map(axes, g2, scale, title)
        figure.colorbar(image, ax=axes, label=shown.label(2), shrink=0.85)
    right.set_ylabel("")


def draw_third_kernel(figure: Figure, kernels: Kernels, shown: Shown, limit: float) -> None:
    """The cross-section tau3 = 1 of g3, as a surface and as a map of the same values."""
    section = third_kernel_section(kernels, shown)
    if not np.isfinite(section).any():
        nothing = figure.subplots()
        nothing.set_axis_off()
        nothing.text(0.5, 0.5, "no element with three different lags", ha="center", color=MUTED)
        return
    _surface(figure.add_subplot(1, 2, 1, projection="3d"), section, limit)
    axes = figure.add_subplot(1, 2, 2)
    image = _map(axes, section, limit, "the same, as a map")
    figure.colorbar(image, ax=axes, label=shown.label(3), shrink=0.85)


def third_kernel_section(kernels: Kernels, shown: Shown) -> Array:
    """The cross-section tau3 = 1 as drawn, (M, M); all NaN where the memory ends before it."""
    if kernels.memory <= TAU_3:
        return np.full((kernels.memory, kernels.memory), np.nan)
    return kernels.g3_section(TAU_3) * shown.factor(kernels, 3)


def third_kernel_limit(kernels: Kernels, shown: Shown) -> float:
    """The largest magnitude of the drawn cross-section."""
    return symmetric_limit(third_kernel_section(kernels, shown))


def _map(axes: Axes, values: Array, limit: float, title: str) -> AxesImage:
    axes.set_facecolor(UNKNOWN)
    axes.grid(visible=False)
    image = axes.imshow(
        values, origin="lower", interpolation="none", cmap=SIGNED_MAP, vmin=-limit, vmax=limit
    )
    row, column = np.nonzero(np.nan_to_num(values) < -MARKED * limit)
    axes.plot(column, row, linestyle="", marker="_", markersize=3.0, color=ACTUAL)
    row, column = np.nonzero(np.isnan(values))
    axes.plot(column, row, linestyle="", marker="x", markersize=2.5, color="white")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(integer=True))
    caption_axes(axes, title, "τ₁ (samples)", "τ₂ (samples)")
    return image


def _surface(axes: Any, section: Array, limit: float) -> None:
    """Draw on an Axes3D, which matplotlib leaves without types."""
    lags = np.arange(section.shape[0], dtype=np.float64)
    tau_1, tau_2 = np.meshgrid(lags, lags)
    axes.plot_surface(
        tau_1,
        tau_2,
        _bridged(section),
        cmap=SIGNED_MAP,
        vmin=-limit,
        vmax=limit,
        rstride=1,
        cstride=1,
        edgecolor="#333333",
        linewidth=0.25,
        antialiased=True,
    )
    axes.view_init(elev=28.0, azim=-128.0)
    axes.set_xlabel("τ₁ (samples)", labelpad=-2)
    axes.set_ylabel("τ₂ (samples)", labelpad=-2)
    axes.tick_params(pad=-1)
    axes.tick_params(axis="z", pad=2)
    axes.set_title("surface, bridged where two lags are alike")


def _bridged(section: Array) -> Array:
    """Unidentifiable cells as the mean of their identified neighbours, for the surface alone."""
    known = np.isfinite(section)
    filled = np.where(known, section, 0.0)
    while not known.all() and known.any():
        total, count = (_around(array) for array in (filled, known.astype(np.float64)))
        reached = ~known & (count > 0.0)
        filled = np.where(reached, total / np.maximum(count, 1.0), filled)
        known = known | reached
    return filled


def _around(values: Array) -> Array:
    """The sum over the eight neighbours of each cell."""
    padded = np.pad(values, 1)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    total: Array = windows.sum(axis=(2, 3)) - values
    return total
