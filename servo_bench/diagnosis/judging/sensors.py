"""What a channel is that no rig makes so: counted the other way, read at another time, averaged.

Nobody's physics is wrong then, and no effect explains it. So it is looked for where nothing else
explained the error, and told in words: what it looks like, and what to write in the map.

    measured increments over the simulated ones     sign, counts per revolution, gear
    the instant at which the simulation, taken there, comes nearest to the channel
    the low pass through which the simulated current comes nearest to the measured one
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.evidence import coarser, median_of
from servo_bench.diagnosis.comparing.rows import Array, Rows
from sim_rig.model import Model

ANGLES = {"motor_position_rad": "motor's angle", "load_angle_rad": "load's angle"}
CURRENT = "current_a"
TIMED = {
    "load_angle_rad": ("load's angle", "load_sampled"),
    "motor_position_rad": ("motor's angle", "motor_sampled"),
    CURRENT: ("torque or current", "current_sampled"),
}
"""What may be read at a time of its own; in words, and its role in a map."""
ONE_SCALE = 0.15
LONG_ROWS = 12
"""Of increments that a gap or a loop's answer hardly changes."""
ALIKE, ANOTHER_SIZE = 0.9, 0.3
"""Correlation of a channel that is the rig's but for its scale; and how far that is from one."""
EARLIEST, LATEST = 1.0, -4.0
"""Periods after the row's time between which a sample is looked for."""
STEPS = (0.5, 0.25, 0.125)
LOW_PASSES, RATIOS = (0.0625, 32.0, 10), (1.4, 1.2, 1.1, 1.05, 1.025, 1.012)
"""Periods between which a low pass is looked for, and by what ratios its time is then bettered."""
FAR_NEARER = 0.5
"""Of its error, what a channel may keep where its time alone was wrong."""
LEAST_PERIODS = 0.03


def misread(comparison: Comparison, nominal: Model, found: Model) -> Iterator[str]:
    """What stands in the channels of a closed loop's recording, one sentence for each.

    `found` has the causes that do not explain it: a cause may hide what a sensor does, or it may
    have been bent to stand in for it.
    """
    if comparison.block != "loop":
        return
    scaled = dict(_scales(comparison, nominal))
    if len(scaled) == len(ANGLES) and _are_one(tuple(scaled.values())):
        scale = float(np.mean(tuple(scaled.values())))
        yield (
            f"Motor and load move {scale:.3g} times as far as the command asks of the rig, both: "
            "look at the command's unit (1 rpm is 0.105 rad/s, 1 degree/s 0.0175) and its scale."
        )
        return
    for channel, scale in scaled.items():
        yield (
            f"The {ANGLES[channel]} moves {scale:.3g} times as far as the rig's would: look at its "
            "sign, its counts per revolution, and the gear between."
        )
    if not scaled:
        yield from _as_read(comparison, [coarser(model) for model in (nominal, found)])


def _are_one(scales: Sequence[float]) -> bool:
    """Whether all differ by what a gap and an error of the loop may make of one."""
    return max(scales) - min(scales) < ONE_SCALE * float(np.abs(scales).max())


def _scales(comparison: Comparison, model: Model) -> Iterator[tuple[str, float]]:
    for channel in ANGLES:
        if not comparison.source.rows.has(channel):
            continue
        measured, shown = _increments(comparison, model, channel)
        size = float(shown @ shown)
        alike = float(measured @ shown) / max(np.sqrt(size * float(measured @ measured)), 1e-30)
        scale = float(measured @ shown) / max(size, 1e-30)
        if abs(alike) > ALIKE and abs(scale - 1.0) > ANOTHER_SIZE:
            yield channel, scale


def _increments(comparison: Comparison, model: Model, channel: str) -> tuple[Array, Array]:
    found = []
    for points in comparison.pieces:
        shown = comparison.source.play(model, points.piece)[channel]
        came = comparison.source.rows.channel(channel)[points.piece.rows]
        both = np.stack(
            [came[LONG_ROWS:] - came[:-LONG_ROWS], shown[LONG_ROWS:] - shown[:-LONG_ROWS]]
        )
        found.append(both[:, np.isfinite(both).all(axis=0)])
    measured, simulated = np.concatenate(found, axis=1)
    return measured, simulated


class _Reading(NamedTuple):
    """A way in which a channel may have been read: the error of all signals with it, in floors;
    that of the channel's own ones with it and as it is; and how to say it."""

    error: float
    left: float
    now: float
    words: str


def _as_read(comparison: Comparison, models: Sequence[Model]) -> Iterator[str]:
    """The one channel whose time or filter alone explains most, if that is much."""
    named = {signal.simulated for signal in comparison.signals}
    named |= {signal.less for signal in comparison.signals if signal.less}
    if ANGLES.keys() & named != ANGLES.keys():
        return  # of one angle alone a late sensor is a late command
    readings = [_late(comparison, m, c) for c in TIMED if c in named for m in models]
    if CURRENT in named and not comparison.source.rows.filtered_s:
        readings += [_filtered(comparison, model) for model in models]
    best = min(readings)
    if best.left < FAR_NEARER * best.now < np.inf and best.words:
        nearer = best.now / max(best.left, 1e-3)
        yield f"It is {nearer:.2g} times nearer to the simulation if {best.words} says so."


def _late(comparison: Comparison, model: Model, channel: str) -> _Reading:
    """Read at the instant that makes the error of all signals least."""
    period_s = comparison.source.rows.period_s

    def error(after: float) -> tuple[float, float]:
        rows = comparison.source.rows
        told = {**rows.after_s, channel: np.full(len(rows.t_s), after * period_s)}
        if channel == "motor_position_rad":  # the current has its own instant all the same
            told.setdefault(CURRENT, np.full(len(rows.t_s), _own(comparison, CURRENT)))
        return _error(comparison, model, channel, replace(rows, after_s=told))

    now = _own(comparison, channel) / period_s
    tried = {after: error(after) for after in np.arange(LATEST, EARLIEST + 0.1, STEPS[0]).tolist()}
    tried[now] = error(now)
    for step in STEPS[1:]:
        best = min(tried, key=tried.__getitem__)
        tried |= {after: error(after) for after in (best - step, best + step)}
    best = min(tried, key=tried.__getitem__)
    what, role = TIMED[channel]
    period_ms = period_s * 1e3
    words = (
        f"the {what} was sampled {abs(best) * period_ms:.3g} ms "
        f"{'before' if best < 0.0 else 'after'} its row's time: is it late? In the map of an "
        f'import role = "{role}", value = {best * period_ms:.3g}, unit = "ms"'
    )
    return _Reading(*tried[best], tried[now][1], words if abs(best - now) > LEAST_PERIODS else "")


def _filtered(comparison: Comparison, model: Model) -> _Reading:
    """A current that went through the low pass that makes the error of all signals least."""
    rows = comparison.source.rows

    def error(periods: float) -> tuple[float, float]:
        return _error(comparison, model, CURRENT, replace(rows, filtered_s=periods * rows.period_s))

    _, now = error(0.0)
    tried = {periods: error(periods) for periods in np.geomspace(*LOW_PASSES).tolist()}
    for ratio in RATIOS:
        best = min(tried, key=tried.__getitem__)
        tried |= {periods: error(periods) for periods in (best / ratio, best * ratio)}
    best = min(tried, key=tried.__getitem__)
    tau_ms = best * rows.period_s * 1e3
    what, _ = TIMED[CURRENT]
    words = (
        f"the {what} went through a low pass of {tau_ms:.3g} ms: does the drive tell an average? "
        f"drive.torque_filter_s = {tau_ms * 1e-3:.3g} in the rig's file, or in the map of an "
        f'import role = "current_filtered", value = {tau_ms:.3g}, unit = "ms"'
    )
    inside = LOW_PASSES[0] < best < LOW_PASSES[1]  # else it is longer, or something else
    return _Reading(*tried[best], now, words if inside else "")


def _error(comparison: Comparison, model: Model, channel: str, rows: Rows) -> tuple[float, float]:
    """Of all signals and of the channel's own, in floors, with rows that say otherwise."""
    source = comparison.source._replace(rows=rows)
    (shown,) = replace(comparison, source=source).errors_of([model])
    if not np.isfinite(shown).any():  # so late a sample cannot be played
        return np.inf, np.inf
    known = np.where(comparison.seen, shown, np.nan)
    sizes = np.array([signal.floor for signal in comparison.signals])
    each = np.array([median_of(np.abs(row)) for row in known / sizes[:, None]])
    own = [channel in {signal.simulated, signal.less} for signal in comparison.signals]
    return float(each.sum()), float(each[own].sum())


def _own(comparison: Comparison, channel: str) -> float:
    """The instant at which the channel is compared already, s after its row's time."""
    after_s = comparison.source.rows.after_s
    motor = "motor_position_rad" if channel == CURRENT else channel
    told = after_s.get(channel, after_s.get(motor))
    return float(np.median(told)) if told is not None else 0.0
