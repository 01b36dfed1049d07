"""How punctual a run was, as figures: lateness, interval of the asks, and when what went wrong.

Every channel may be missing (a recording from elsewhere): the figure then says so.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from numpy.typing import NDArray

from servo_bench.excitation.experiment import Phase
from servo_bench.kernels.quality import RunQuality
from servo_bench.recording.recording import MISSING, Recording
from servo_bench.report.style import ACTUAL, ALARM, MUTED, ORDER_1, ORDER_3, caption_axes

Array = NDArray[np.float64]

S_TO_US = 1e6
NS_TO_US = 1e-3
SHORTEST_US = 1.0
"""Lateness below this is drawn here: the axis is logarithmic."""
COLUMNS = 400
"""How many columns a whole run is drawn in; each holds its slots' largest lateness."""
LEGEND_ABOVE: dict[str, Any] = {
    "loc": "lower left",
    "bbox_to_anchor": (0.0, 1.0),
    "borderaxespad": 0.1,
    "columnspacing": 1.0,
    "handlelength": 1.4,
}
PHASES = {int(phase): phase.name.lower().replace("_", "-") for phase in Phase}
NAMED_SHARE = 0.1
"""A phase that is shorter than this share of the run carries no name."""


def draw_punctuality(figure: Figure, recording: Recording, quality: RunQuality) -> None:
    """The histograms of the wake-ups' lateness and of the interval between asks."""
    left, right = figure.subplots(1, 2)
    _lateness(left, recording, quality)
    _interval(right, recording)


def draw_timeline(axes: Axes, recording: Recording) -> None:
    """Lateness over the run, and marks where slots were skipped or answers missing or late."""
    if "slot" not in recording or not len(recording):
        _not_recorded(axes, "slot")
        return
    slot = recording["slot"].astype(np.int64)
    end_s = float(slot[-1] + 1) * recording.period_s
    lateness = _channel(recording, "lateness_s") * S_TO_US
    if np.isfinite(lateness).any():
        _columns(axes, slot / float(slot[-1] + 1), lateness, end_s)
    axes.set_yscale("log")
    _plain_numbers(axes.yaxis)
    top = max(2e1 * SHORTEST_US, float(lateness[np.isfinite(lateness)].max(initial=0.0)))
    axes.set_ylim(SHORTEST_US, 60.0 * top)
    happened = [mishap for mishap in _mishaps(recording, slot) if mishap.slots.size]
    for row, mishap in enumerate(happened):
        axes.plot(
            mishap.slots * recording.period_s,
            np.full(mishap.slots.size, top * 3.0 * 2.8**row),
            linestyle="",
            marker=mishap.marker,
            color=mishap.colour,
            label=f"{mishap.name}: {mishap.slots.size}",
        )
    _phases(axes, recording, slot)
    axes.set_xlim(0.0, end_s)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(**LEGEND_ABOVE, ncols=5)
    else:
        axes.set_title("nothing went wrong, but lateness_s was not recorded")
    caption_axes(axes, "", "time in the run (s)", "lateness (µs)")


def _lateness(axes: Axes, recording: Recording, quality: RunQuality) -> None:
    lateness = _channel(recording, "lateness_s") * S_TO_US
    lateness = lateness[np.isfinite(lateness)]
    if not lateness.size:
        _not_recorded(axes, "lateness_s")
        return
    _histogram(axes, lateness, MUTED)
    for value_s, name, dash in (
        (quality.lateness_p50_s, "p50", "-"),
        (quality.lateness_p99_s, "p99", "--"),
        (quality.lateness_max_s, "max", ":"),
    ):
        value_us = value_s * S_TO_US
        label = f"{name} {value_us:.4g} µs"
        axes.axvline(max(value_us, SHORTEST_US), color=ACTUAL, linestyle=dash, label=label)
    axes.legend(**LEGEND_ABOVE, ncols=3)
    caption_axes(axes, "", "wake-up after the deadline (µs)", "slots")


def _interval(axes: Axes, recording: Recording) -> None:
    if "asked_ns" not in recording or "slot" not in recording:
        _not_recorded(axes, "asked_ns")
        return
    asked, slot = recording["asked_ns"], recording["slot"]
    told = (np.diff(slot) == 1) & (asked[1:] != MISSING) & (asked[:-1] != MISSING)
    interval_us = np.diff(asked)[told] * NS_TO_US - recording.period_s * S_TO_US
    if not interval_us.size:
        _not_recorded(axes, "asked_ns")
        return
    _histogram(axes, np.abs(interval_us), ORDER_3)
    rms_us = float(np.sqrt(np.mean(interval_us**2)))
    axes.axvline(
        max(rms_us, SHORTEST_US), color=ACTUAL, linestyle="-", label=f"rms {rms_us:.4g} µs"
    )
    largest_us = float(np.abs(interval_us).max())
    axes.axvline(
        max(largest_us, SHORTEST_US), color=ACTUAL, linestyle=":", label=f"max {largest_us:.4g} µs"
    )
    axes.legend(**LEGEND_ABOVE, ncols=2)
    nominal_ms = recording.period_s * 1e3
    caption_axes(axes, "", f"interval between asks, off {nominal_ms:g} ms by (µs)", "slots")


def _histogram(axes: Axes, values_us: Array, colour: str) -> None:
    """Counts over both axes logarithmic; what is shorter than the axis is in its first bar."""
    drawn = np.maximum(values_us, SHORTEST_US)
    edges = np.geomspace(SHORTEST_US, max(drawn.max() * 1.05, 10.0 * SHORTEST_US), 60)
    axes.hist(drawn, edges.tolist(), color=colour)
    axes.set_xscale("log")
    axes.set_yscale("log", nonpositive="clip")
    axes.set_ylim(0.7)
    _plain_numbers(axes.xaxis)
    _plain_numbers(axes.yaxis)


def _plain_numbers(axis: Axis) -> None:
    """1,000 instead of a power of ten."""
    axis.set_major_locator(LogLocator(numticks=7))
    axis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axis.set_minor_formatter(NullFormatter())


def _columns(axes: Axes, place: Array, lateness_us: Array, end_s: float) -> None:
    """Median and largest lateness of each column of slots; `place` runs from 0 to 1."""
    column = np.minimum((place * COLUMNS).astype(np.int64), COLUMNS - 1)
    known = np.isfinite(lateness_us)
    held = np.unique(column[known])
    groups = [lateness_us[known & (column == c)] for c in held]
    centre = (held + 0.5) * end_s / COLUMNS
    for reduce, colour, label in (
        (np.max, MUTED, "largest"),
        (np.median, ACTUAL, "median"),
    ):
        height = np.maximum([float(reduce(group)) for group in groups], SHORTEST_US)
        axes.plot(centre, height, color=colour, linewidth=0.8, label=label)


@dataclass(frozen=True, slots=True, eq=False)
class _Mishap:
    """The slots in which one kind of thing went wrong, and its mark."""

    name: str
    slots: NDArray[np.int64]
    marker: str
    colour: str


def _mishaps(recording: Recording, slot: NDArray[np.int64]) -> tuple[_Mishap, ...]:
    skipped = np.setdiff1d(np.arange(slot[0], slot[-1] + 1), slot)
    missing = np.zeros(slot.size, np.bool_)
    late = np.zeros(slot.size, np.bool_)
    for name in ("drive_latency_s", "encoder_latency_s"):
        latency = _channel(recording, name)
        if latency.size:
            missing |= np.isnan(latency)
            late |= latency > recording.period_s
    return (
        _Mishap("missed slots", skipped, "v", ALARM),
        _Mishap("answers missing", slot[missing], "x", ORDER_1),
        _Mishap("answers late", slot[late], "^", ORDER_3),
    )


def _phases(axes: Axes, recording: Recording, slot: NDArray[np.int64]) -> None:
    """A thin line where a phase begins, with its name."""
    if "phase" not in recording:
        return
    phase = recording["phase"].astype(np.int64)
    begins = np.flatnonzero(np.diff(phase, prepend=-1) != 0)
    for row, stop in zip(begins, [*begins[1:], phase.size], strict=True):
        at_s = float(slot[row]) * recording.period_s
        axes.axvline(at_s, color=MUTED, linewidth=0.6)
        name = PHASES.get(int(phase[row]), "")
        if stop - row < NAMED_SHARE * phase.size:
            continue
        axes.annotate(
            name,
            (at_s, 0.04),
            (3, 0),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            fontsize=7.5,
            color=ACTUAL,
        )


def _channel(recording: Recording, name: str) -> Array:
    return recording[name].astype(np.float64) if name in recording else np.zeros(0)


def _not_recorded(axes: Axes, channel: str) -> None:
    axes.set_axis_off()
    axes.text(
        0.5,
        0.5,
        f"{channel} was not recorded",
        ha="center",
        va="center",
        color=MUTED,
        transform=axes.transAxes,
    )
