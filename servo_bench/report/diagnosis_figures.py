"""A diagnosis as figures: before and after, the evidence, and the error without any model of it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from servo_bench.diagnosis.comparing.comparison import Comparison, compare
from servo_bench.diagnosis.comparing.locking import (
    LEAST_PERIODS,
    ORDERS,
    after_edges,
    binned,
    line_shares,
)
from servo_bench.diagnosis.comparing.rounding import floor_of
from servo_bench.diagnosis.comparing.rows import Array, Mask
from servo_bench.diagnosis.judging.causes import causes_of
from servo_bench.diagnosis.judging.judgement import fitted_of
from servo_bench.diagnosis.judging.picture import Track
from servo_bench.diagnosis.searching.contenders import Contender, Round
from servo_bench.diagnosis.searching.finding import Finding
from servo_bench.report.style import ACTUAL, BAND, MUTED, ORDER_1, ORDER_3, caption_axes

STRETCH_S = 0.6
SHOWN_SCREENED = 12
TIME_POINTS = 400


class Judged(NamedTuple):
    """Data that no fit saw, and the errors of the nominal and the extended model there."""

    comparison: Comparison
    where: Array
    nominal: Array
    extended: Array
    quantum_rad: float

    def rms(self) -> list[tuple[str, str, float, float, float]]:
        """Signal, unit, rms before and after, and the sensor's floor."""
        period_s = self.comparison.source.rows.period_s
        before, after = (
            self.comparison.rms(e, self.where > 0.0) for e in (self.nominal, self.extended)
        )
        return [
            (s.name, s.unit, float(b), float(a), floor_of(s, self.quantum_rad, period_s))
            for s, b, a in zip(self.comparison.signals, before, after, strict=True)
        ]


def judged(finding: Finding) -> Judged:
    """On the hold-out, or on the recording's own validation."""
    judge = finding.held_out or finding.recordings[0]
    comparison = compare(judge, finding.final.model, finding.whole.fitted[0].block)
    where = comparison.held_out
    if finding.held_out is not None:
        where = where | comparison.seen
    sent = compare(finding.told, finding.nominal, comparison.block)  # lost ones among them
    (nominal,) = sent.errors_of([finding.nominal])
    extended_model = fitted_of(finding, tuple(causes_of(finding))).model
    (extended,) = comparison.errors_of([extended_model])
    return Judged(comparison, where.astype(np.float64), nominal, extended, finding.quantum_rad)


def draw_before_after(figure: Figure, found: Judged) -> None:
    """The measured signal, both simulations, and their errors, where the nominal is most wrong."""
    comparison = found.comparison
    start = np.concatenate([p.start for p in comparison.pieces])
    time_s = comparison.source.rows.t_s[start]
    rows = _stretch(found, comparison.source.rows.period_s)
    measured, (signal, *_) = comparison.measured[0], comparison.signals
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.6, 1.0])
    at = time_s[rows]
    above.step(at, measured[rows], color=ACTUAL, where="post", label="measured")
    both = (
        (found.nominal[0], ORDER_1, "--", "nominal simulation"),
        (found.extended[0], ORDER_3, "-", "extended simulation"),
    )
    for error, colour, dash, label in both:
        style = {"color": colour, "linestyle": dash, "where": "post"}
        above.step(at, (measured - error)[rows], label=label, linewidth=1.0, **style)
        below.step(at, error[rows], linewidth=0.9, **style)
    below.axhline(0.0, color=MUTED, linewidth=0.6)
    caption_axes(
        above, "where the nominal simulation is most wrong", "", f"{signal.name}\n({signal.unit})"
    )
    caption_axes(below, "measured less simulated", "time (s)", f"error\n({signal.unit})")
    handles, labels = above.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    figure.align_ylabels([above, below])


def _stretch(found: Judged, period_s: float) -> slice:
    length = min(max(round(STRETCH_S / period_s), 30), found.nominal.shape[1])
    error = np.where(found.where > 0.0, np.nan_to_num(found.nominal[0]), 0.0)
    energy = np.convolve(np.minimum(error**2, 9.0 * np.mean(error**2)), np.ones(length), "valid")
    first = int(energy.argmax())
    return slice(first, first + length)


def draw_evidence(
    figure: Figure, played: Round, chosen: Contender | None, rival: str | None = None
) -> None:
    """What screening promised, what the fits left, and in which blocks the first one gains."""
    promised, left, blocks = figure.subplots(1, 3, width_ratios=[1.15, 1.0, 1.2])
    best = played.screened[:SHOWN_SCREENED]
    first = chosen.effect if chosen else None
    gains = [100.0 * max(s.gain, 0.0) for s in best]  # a template that fits worse promises nothing
    free = "not screened:\nfree in every fit" if chosen else "nothing"
    _bars(promised, [s.hypothesis.effect for s in best], gains, first, none=free)
    promised.set_xlim(left=0.0)
    caption_axes(promised, "screened: promised", "share of the cost (%)", "")
    base = float(played.base_costs.sum())
    fitted = played.contenders
    _bars(left, [c.effect for c in fitted], [100.0 * c.total / base for c in fitted], first)
    for bars in left.containers:  # what fits well leaves too little to be seen
        left.bar_label(bars, fmt="%.3g", padding=2, fontsize=6.5, color=MUTED)
    left.set_xlim(0.0, 125.0)
    caption_axes(left, "fitted: cost left", "of the base's cost (%)", "")
    _draw_blocks(blocks, played, chosen, rival)


def _bars(
    axes: Axes,
    names: Sequence[str],
    values: Sequence[float],
    first: str | None,
    none: str = "nothing",
) -> None:
    rows = np.arange(len(names))
    axes.barh(rows, values, height=0.6, color=[ORDER_3 if n == first else BAND for n in names])
    axes.set_yticks(rows, [name.replace("_", " ") for name in names], fontsize=6.5)
    axes.set_ylim(max(len(names), 3) - 0.5, -0.5)
    axes.grid(axis="y", visible=False)
    if not names:
        axes.text(0.5, 0.5, none, ha="center", transform=axes.transAxes, color=MUTED)


def _draw_blocks(axes: Axes, played: Round, chosen: Contender | None, rival: str | None) -> None:
    """Block by block: advantage over the base, and over the rival that the verdict has."""
    caption_axes(axes, "advantage, sorted", "block (0.5 s each)", "signed root of cost")
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    if chosen is None:
        said = "none was accepted" if played.contenders else "nothing was fitted"
        axes.text(0.5, 0.5, said, ha="center", transform=axes.transAxes, color=MUTED)
        return
    others = [c for c in played.contenders if c is not chosen and c.effect == rival]
    pairs = [(played.base_costs, "over the base", ORDER_3, "-")]
    if others:
        best = min(others, key=lambda c: c.total)
        pairs.append((best.costs, f"over {best.effect.replace('_', ' ')}", ORDER_1, "--"))
    for costs, label, colour, dash in pairs:
        judged = (costs != 0.0) | (chosen.costs != 0.0)  # a block may lie in one part only
        gained = (costs - chosen.costs)[judged]
        gained = np.sort(np.sign(gained) * np.sqrt(np.abs(gained)))
        axes.plot(gained, color=colour, linestyle=dash, label=label)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.25 * (high - low))  # room for the legend
    axes.legend(loc="upper left", fontsize=6.5)


def draw_signature(figure: Figure, track: Track) -> None:
    """The error by velocity, by order, after an edge, and in time."""
    (speed, order), (edge, time) = figure.subplots(2, 2)
    moving = track.known & ~track.still
    unit = track.signal.unit
    by = binned(track.velocity_rad_s[moving], track.error[moving])
    speed.fill_between(by.at, by.mean - by.scatter, by.mean + by.scatter, color=BAND, linewidth=0)
    speed.plot(by.at, by.mean, color=ORDER_3, marker="o", markersize=2.5)
    caption_axes(speed, "by velocity: mean, scatter", "motor velocity (rad/s)", f"error ({unit})")
    _draw_orders(order, track, moving)
    answer, _ = after_edges(track.jumps_rad_s, track.error, moving)
    edge.plot(np.arange(answer.size), answer, color=ORDER_3, marker="o", markersize=2.5)
    edge.axhline(0.0, color=MUTED, linewidth=0.6)
    caption_axes(edge, "after a jump of the command", "rows since", f"error ({unit} per rad/s)")
    place = np.array_split(np.flatnonzero(track.known), TIME_POINTS)
    place = [p for p in place if p.size]
    at = [float(track.time_s[p].mean()) for p in place]
    level = [float(np.sqrt(np.mean(track.error[p] ** 2))) for p in place]
    mean = [float(track.error[p].mean()) for p in place]
    time.plot(at, level, color=BAND, label="rms")
    time.plot(at, mean, color=ORDER_3, linewidth=0.9, label="mean")
    time.set_ylim(top=1.25 * time.get_ylim()[1])  # room for the legend above the error
    time.legend(loc="upper right", fontsize=6.5, ncols=2)
    caption_axes(time, "in time", "time (s)", f"error ({unit})")


def _draw_orders(axes: Axes, track: Track, moving: Mask) -> None:
    error, angle = track.error[moving], track.angle_rad[moving]
    shares = line_shares(angle, error)
    turned = line_shares(angle, error, np.sign(track.velocity_rad_s[moving]))
    axes.plot(ORDERS, 100.0 * shares, color=ORDER_3, label="as it is")
    axes.plot(ORDERS, 100.0 * turned, color=ORDER_1, linestyle=":", label="times the direction")
    axes.set_ylim(0.0, max(5.0, axes.get_ylim()[1]))
    turns = float(np.ptp(angle)) / (2.0 * np.pi) if angle.size else 0.0
    title = (
        f"by position, {turns:.1f} turns" if turns >= LEAST_PERIODS else "by position: no full turn"
    )
    caption_axes(axes, title, "order (per revolution)", "share (%)")
    axes.legend(loc="upper right", fontsize=6.5)
