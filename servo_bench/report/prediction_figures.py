"""Measured beside predicted, and where the response's variance lies."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from servo_bench.kernels.analysis import Analysis, Validation
from servo_bench.kernels.comparison import Comparison
from servo_bench.report.style import ACTUAL, BAND, MUTED, ORDER_1, ORDER_3, caption_axes

Array = NDArray[np.float64]

WINDOW_SAMPLES = 80
"""How much of a response is shown: enough to see the shape, few enough to tell the marks apart."""


def draw_comparison(
    axes: Axes, time: Array, comparison: Comparison, scale: float, labels: tuple[str, str, str]
) -> None:
    """Actual as a line, order 1 as x, order 3 as +, over the window that `time` covers.

    `labels` are the title and those of the axes.
    """
    shown = slice(0, time.size)
    _actual_and_predicted(
        axes,
        time,
        [scale * y[shown] for y in (comparison.measured, comparison.order1, comparison.order3)],
        labels,
    )
    axes.axhline(0.0, color=MUTED, linewidth=0.6, zorder=0)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1)


def draw_validation(figure: Figure, validation: Validation) -> None:
    """The load's velocity over the validation's first samples, and below it the load angle."""
    upper, lower = figure.subplots(2, 1, sharex=True)
    samples = min(WINDOW_SAMPLES, validation.velocity.measured.size)
    time_s = validation.time_s[:samples]
    draw_comparison(
        upper,
        time_s,
        validation.velocity,
        float(np.rad2deg(1.0)),
        ("Load velocity", "", "velocity (deg/s)"),
    )
    angles = (validation.angle_rad, validation.angle_order1_rad, validation.angle_order3_rad)
    _actual_and_predicted(
        lower,
        time_s,
        [np.rad2deg(angle[:samples]) for angle in angles],
        (
            "Load angle; predicted: velocities integrated from the first angle",
            "time in the validation (s)",
            "angle (deg)",
        ),
    )


def draw_angle_error(axes: Axes, validation: Validation) -> None:
    """Predicted less measured load angle over the whole validation."""
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    for angle, colour, dash, label in (
        (validation.angle_order1_rad, ORDER_1, "--", "order 1"),
        (validation.angle_order3_rad, ORDER_3, "-", "order 1 to 3"),
    ):
        error = np.rad2deg(angle - validation.angle_rad)
        axes.plot(
            validation.time_s, error, color=colour, linestyle=dash, linewidth=0.9, label=label
        )
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.1)
    caption_axes(axes, "Predicted less measured angle", "time in the validation (s)", "error (deg)")


def draw_energies(axes: Axes, analysis: Analysis) -> None:
    """The share of the response's variance in each order, and what is in none."""
    shares = (*analysis.energy_percent, max(0.0, 100.0 - sum(analysis.energy_percent)))
    names = ("order 1", "order 2", "order 3", "in none of these")
    colours = (ORDER_1, BAND, ORDER_3, MUTED)
    bars = axes.barh(names, shares, color=colours, height=0.62)
    axes.bar_label(bars, [f"{share:.3g} %" for share in shares], padding=4)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 112.0)
    axes.grid(visible=False, axis="y")
    caption_axes(axes, "", "share of the response's variance (%)", "")


def _actual_and_predicted(
    axes: Axes, time: Array, series: Sequence[Array], labels: tuple[str, str, str]
) -> None:
    actual, order_1, order_3 = series
    axes.plot(time, actual, color=ACTUAL, linewidth=1.0, label="actual")
    for values, colour, marker, label in (
        (order_1, ORDER_1, "x", "order 1"),
        (order_3, ORDER_3, "+", "order 1 to 3"),
    ):
        axes.plot(
            time,
            values,
            color=colour,
            linestyle="",
            marker=marker,
            markersize=4.2,
            markeredgewidth=1.0,
            label=label,
        )
    axes.margins(x=0.01)
    caption_axes(axes, *labels)
