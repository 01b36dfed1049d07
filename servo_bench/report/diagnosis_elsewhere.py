"""Data from elsewhere as a figure: what was measured, and what two models make of it."""

import numpy as np
from matplotlib.figure import Figure

from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.elsewhere import Shown
from servo_bench.report.style import ACTUAL, MUTED, ORDER_1, ORDER_3, caption_axes

POINTS = 3000
STRETCH = 150
"""Rows that are drawn, at most; and those of a motion in time, where the plain model is worst."""


def draw_shown(figure: Figure, shown: Shown) -> None:
    """Left the signal over what it is a law of, right the errors in time."""
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    in_time = shown.over_name == "time"
    rows = _stretch(shown) if in_time else slice(None, None, -(-shown.time_s.size // POINTS))
    line = {"linestyle": "-", "marker": ""} if in_time else {"linestyle": "", "marker": "."}
    style = {**line, "linewidth": 1.0, "markersize": 2.0}
    for values, colour, name in (
        (shown.measured, ACTUAL, "measured"),
        (shown.plain, ORDER_1, "plain model"),
        (shown.extended, ORDER_3, "extended model"),
    ):
        left.plot(shown.over[rows], values[rows], color=colour, label=name, **style)
    where = "where the plain model is worst" if in_time else f"over the {shown.over_name}"
    caption_axes(
        left, where, f"{shown.over_name} ({shown.over_unit})", f"{shown.signal} ({shown.unit})"
    )
    every = slice(None, None, -(-shown.time_s.size // POINTS))
    for values, colour in ((shown.plain, ORDER_1), (shown.extended, ORDER_3)):
        error = (shown.measured - values)[every]
        right.plot(shown.time_s[every], error, color=colour, linestyle="", marker=".", markersize=2)
    right.axhline(0.0, color=MUTED, linewidth=0.6)
    caption_axes(right, "measured less the models", "time (s)", f"error ({shown.unit})")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, markerscale=3.0)


def _stretch(shown: Shown) -> slice:
    """The rows in which the plain model's error is largest."""
    length = min(STRETCH, shown.time_s.size)
    error: Array = (shown.measured - shown.plain) ** 2
    energy = np.convolve(np.minimum(error, 9.0 * np.mean(error)), np.ones(length), "valid")
    first = int(energy.argmax())
    return slice(first, first + length)
