"""A campaign on one picture: what was named for what, how much it explained, how sure it was.

Left: the confusion matrix, a row for each hidden cause and a column for each name; shade and number
say how many of the row's trials. The frame marks names that are right. Beside it, on the same rows,
the share of the explainable held-out error that was removed. Right: the calibration of the
confidences, and the figures.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from servo_bench.report.style import ACTUAL, MUTED, ORDER_3, STYLE
from tests.trials.names import RIGHT, Channels, right_names
from tests.truth.catalogue import BY_NAME

DPI = 110
CELL_IN = 0.20
LAST_COLUMNS = ("none", "unknown", "failed")

Group = Mapping[str, Any]


def draw(campaign: Mapping[str, Any], path: Path) -> None:
    """Write a PNG for the first set of channels that the campaign has.

    Nothing without trials, or of pairs alone, which have no row.
    """
    channels: Channels | None = next((c for c in ("all", "load") if c in campaign), None)
    if channels is None or not campaign[channels]["confusion"]:
        return
    group = campaign[channels]
    confusion = group["confusion"]
    rows, columns = _rows(confusion), _columns(confusion)
    height_in = max(CELL_IN * len(rows) + 3.2, 6.0)
    with mpl.rc_context({**STYLE, "font.size": 7.5}):
        figure = Figure(figsize=(CELL_IN * len(columns) + 8.2, height_in))
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(
            2, 3, width_ratios=(CELL_IN * len(columns), 1.3, 2.7), hspace=0.25, wspace=0.12
        )
        matrix = figure.add_subplot(grid[:, 0])
        _draw_matrix(matrix, confusion, rows, columns, channels)
        _draw_explained(figure.add_subplot(grid[:, 1], sharey=matrix), group, rows)
        _draw_calibration(figure.add_subplot(grid[0, 2]), group["confidence"])
        _write_figures(figure.add_subplot(grid[1, 2]), group)
        what = {"all": "motor encoder, torque and load encoder", "load": "load encoder alone"}
        figure.suptitle(
            f"Hidden-effect campaign, {campaign['date']}: {campaign['trials']} trials, "
            f"{what[channels]}",
            x=0.01,
            y=0.93,
            ha="left",
        )
        figure.savefig(path, dpi=DPI, bbox_inches="tight")


def _rows(confusion: Group) -> list[str]:
    """Causes as the catalogue orders them, then nulls and what has no name."""
    known = [name for name in BY_NAME if name in confusion]
    return known + sorted(set(confusion) - set(known))


def _columns(confusion: Group) -> list[str]:
    """Names in the order of the causes that they are right for, then those that are no names."""
    given = {name for row in confusion.values() for name in row}
    given |= {name for cause in confusion if cause in RIGHT for name in RIGHT[cause].names}
    ordered = list(dict.fromkeys(name for right in RIGHT.values() for name in right.names))
    named = [name for name in ordered if name in given]
    others = sorted(given - set(ordered) - set(LAST_COLUMNS))
    return [*named, *others, *LAST_COLUMNS]


def _is_right(row: str, column: str, channels: Channels) -> bool:
    if row == "(none)":
        return column == "none"
    if row.startswith("("):
        return column == "unknown"
    return column in right_names(row, channels)


def _draw_matrix(
    axes: Axes, confusion: Group, rows: Sequence[str], columns: Sequence[str], channels: Channels
) -> None:
    counts = np.array([[confusion[row].get(column, 0) for column in columns] for row in rows])
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(shares, cmap="Greys", vmin=0.0, vmax=1.4, aspect="auto")
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            right = _is_right(row, column, channels)
            if right:
                frame = Rectangle((j - 0.5, i - 0.5), 1, 1, fill=False, ec=ORDER_3, lw=0.8)
                axes.add_patch(frame)
            if counts[i, j]:
                color = "white" if shares[i, j] > 0.7 else ACTUAL
                axes.text(j, i, str(counts[i, j]), ha="center", va="center", size=6, color=color)
    axes.set_xticks(range(len(columns)), columns, rotation=90)
    axes.set_yticks(range(len(rows)), rows)
    axes.tick_params(length=0, labelsize=7)
    axes.grid(visible=False)
    axes.set_title("hidden (rows), named first (columns); framed: right")


def _draw_explained(axes: Axes, group: Group, rows: Sequence[str]) -> None:
    explained = group["gain"]["share_explained"]
    found = [(explained[row], i) for i, row in enumerate(rows) if row in explained]
    if found:
        axes.plot([share for share, _ in found], [i for _, i in found], "o", color=ORDER_3)
    axes.set_xlim(-0.05, 1.05)
    axes.set_xticks((0.0, 0.5, 1.0))
    axes.tick_params(labelleft=False, left=False)
    axes.set_title("error explained")
    axes.set_xlabel("median share of what\nthe noise leaves, held out")


def _draw_calibration(axes: Axes, confidence: Group) -> None:
    axes.plot((0, 1), (0, 1), color=MUTED, lw=0.8)
    curve = confidence["curve"]
    axes.plot([b["confidence"] for b in curve], [b["right"] for b in curve], "o-", color=ORDER_3)
    for one in curve:
        axes.annotate(
            str(one["of"]),
            (one["confidence"], one["right"]),
            xytext=(4, -9),
            textcoords="offset points",
            size=6.5,
        )
    axes.set_xlim(0.0, 1.03)
    axes.set_ylim(0.0, 1.03)
    axes.set_xlabel("confidence stated")
    axes.set_ylabel("share right")
    axes.set_title("calibration, with the number of names")


def _write_figures(axes: Axes, group: Group) -> None:
    axes.set_axis_off()
    axes.text(0.0, 1.0, "\n".join(_sentences(group)), va="top", size=7.5, linespacing=1.5)


def _sentences(group: Group) -> list[str]:
    lines: list[str] = []
    for kind, figures in (
        ("one", {"top_1": "named right", "in_ambiguity_set": "in the ambiguity set"}),
        ("none", {"false_alarms": "false alarms"}),
        ("outside", {"unknown": "outside: unknown"}),
        ("removed", {"unknown": "removed: unknown"}),
        ("pair", {"both_named": "pairs: both named", "nothing_spurious": "pairs: none spurious"}),
    ):
        lines += [
            f"{text}: {percent(group[kind][k])}" for k, text in figures.items() if kind in group
        ]
    for multiple, found in group.get("multiples_of_the_limit", {}).items():
        lines.append(f"{multiple} x limit: {percent(found['top_1'])}")
    confidence, gain = group["confidence"], group["gain"]
    if confidence["of"]:
        lines.append(f"calibration error {confidence['ece']:.3f}")
        constant = confidence["brier_of_the_best_constant"]
        lines.append(f"Brier {confidence['brier']:.3f} (best constant {constant:.3f})")
    if gain["median_factor"] is not None:
        lines.append(f"held-out error over after: {gain['median_factor']:.2f} (median)")
    return lines


def percent(figure: Group) -> str:
    """A share with its interval: "97 % (93-99 %, of 120)"."""
    low, high = figure["interval"]
    return f"{figure['share']:.1%} ({low:.1%} to {high:.1%} of {figure['of']})"
