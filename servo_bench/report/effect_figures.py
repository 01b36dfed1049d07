"""An effect's signature as a figure: when it shows, where it shows, and what looks like it.

Everything in it is computed (`servo_bench.diagnosis.judging.signature`); nothing is drawn by hand.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from numpy.typing import NDArray

from servo_bench.diagnosis.judging.domains import DOMAINS, ORDERS, Domains
from servo_bench.diagnosis.judging.signature import CHANNELS, PERIOD_S, Rival, Signature
from servo_bench.report.style import ACTUAL, BAND, MUTED, ORDER_1, ORDER_3, caption_axes

Array = NDArray[np.float64]

WINDOW_SAMPLES = 400
COLOURS = (ORDER_3, ACTUAL, ORDER_1)
MARKERS = ("o", "|", "x")
RAD_TO_MRAD = 1e3


def draw_window(figure: FigureBase, signature: Signature) -> None:
    """All three residuals in the 0.4 s in which the load's velocity is most in error."""
    energy = np.convolve(signature.velocity_rad_s**2, np.ones(WINDOW_SAMPLES), "valid")
    first = int(energy.argmax())
    rows = slice(first, first + WINDOW_SAMPLES)
    time_s = np.arange(first, first + WINDOW_SAMPLES) * PERIOD_S
    edges = time_s[1:][np.diff(signature.commands_rad_s[rows]) != 0.0]
    labels = ("load angle\n(mrad)", "load velocity\n(rad/s)", "current\n(A)")
    scales = (RAD_TO_MRAD, 1.0, 1.0)
    every = figure.subplots(3, 1, sharex=True)
    for k, axes in enumerate(every):
        for edge in edges:
            axes.axvline(edge, color=BAND, linewidth=0.6, zorder=0.5)
        axes.plot(time_s, scales[k] * signature.channels[k][rows], color=COLOURS[k], linewidth=0.9)
        axes.set_ylabel(labels[k])
        axes.grid(axis="x", visible=False)
        _never_flat(axes)
    every[0].set_title("residual: with the effect less without; grey: the command changes")
    every[-1].set_xlabel("time (s)")
    every[-1].set_xlim(float(time_s[0]), float(time_s[-1]))
    figure.align_ylabels(every)


def draw_domains(figure: FigureBase, signature: Signature, found: Domains) -> None:
    """By velocity, by position, and after an edge."""
    velocity, position, edge = figure.subplots(1, 3)
    has_current = bool(np.any(signature.current_a))
    scale = 1.0 if has_current else RAD_TO_MRAD
    binned = found.velocity
    low, high = binned.mean - binned.scatter, binned.mean + binned.scatter
    velocity.fill_between(binned.velocity_rad_s, scale * low, scale * high, color=BAND, linewidth=0)
    colour = COLOURS[2 if has_current else 0]
    velocity.plot(binned.velocity_rad_s, scale * binned.mean, color=colour)
    of = "current (A)" if has_current else "load angle (mrad)"
    caption_axes(velocity, "by velocity: mean, scatter", "motor velocity (rad/s)", of)
    _never_flat(velocity)
    _draw_lines(position, found)
    _draw_after_edge(edge, signature, found)


def _draw_lines(axes: Axes, found: Domains) -> None:
    """The best of the three ways in which a position can act."""
    for k in (0, 2):
        best = max((shares[k] for shares in found.lines), key=lambda shares: float(shares.max()))
        axes.plot(ORDERS, 100.0 * best, color=COLOURS[k], linewidth=0.8, label=CHANNELS[k])
        top = int(best.argmax())
        axes.plot(ORDERS[top], 100.0 * best[top], marker=MARKERS[k], color=COLOURS[k])
    axes.set_xscale("log")
    ticks = (1, 10, 100, 1000)
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.minorticks_off()
    axes.set_ylim(0.0, max(5.0, axes.get_ylim()[1]))
    caption_axes(axes, "by position: strongest lines", "order (per revolution)", "share (%)")


def _draw_after_edge(axes: Axes, signature: Signature, found: Domains) -> None:
    """Each channel over the rms of its whole residual: near zero where edges say nothing."""
    edge = found.after_edge
    means = (edge.load_rad, edge.velocity_rad_s, edge.current_a)
    for k, (values, residual) in enumerate(zip(means, signature.channels, strict=True)):
        if residual.any():
            axes.plot(
                1e3 * edge.time_s,
                values / residual.std(),
                color=COLOURS[k],
                linestyle=("-", ":", "--")[k],
                label=CHANNELS[k],
            )
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, -0.5), max(high, 0.5))
    caption_axes(axes, "after an edge: mean", "time since the edge (ms)", "over the residual's rms")
    axes.legend(loc="best", fontsize=6.5, handlelength=1.4, borderaxespad=0.2)


def draw_judgement(figure: FigureBase, found: Domains, alike: Sequence[Rival]) -> None:
    """What explains the residual, and which other effects' residuals look like it."""
    left, right = figure.subplots(1, 2, width_ratios=[1.0, 1.15])
    shares = np.array([found.shares[name] for name in DOMAINS])
    _dots(left, DOMAINS, 100.0 * shares)
    left.set_xlim(-2.0, 102.0)
    caption_axes(left, "where it shows", "share of the variance (%)", "")
    names = [rival.name + (" *" if rival.declared else "") for rival in alike]
    _dots(right, names, np.array([rival.cosines for rival in alike]))
    right.set_xlim(-1.05, 1.05)
    right.axvline(0.0, color=MUTED, linewidth=0.6)
    caption_axes(right, "what looks like it (* declared)", "cosine of both residuals", "")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)


def _dots(axes: Axes, names: Sequence[str], values: Array) -> None:
    """A row for each name, a bar to the largest value, and a mark for each channel."""
    rows = np.arange(len(names))
    strongest = values[rows, np.abs(values).argmax(axis=1)]
    axes.barh(rows, strongest, height=0.5, color=BAND)
    for k, channel in enumerate(CHANNELS):
        axes.plot(
            values[:, k],
            rows,
            linestyle="",
            marker=MARKERS[k],
            markersize=4.5,
            markeredgewidth=1.3,
            color=COLOURS[k],
            label=channel,
        )
    axes.set_yticks(rows, list(names))
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(axis="y", visible=False)


def _never_flat(axes: Axes) -> None:
    """A residual that is zero, or rounding, is drawn as a line in the middle."""
    low, high = axes.get_ylim()
    if max(abs(low), abs(high)) < 1e-6:
        axes.set_ylim(-1.0, 1.0)
        axes.set_yticks([0.0])
