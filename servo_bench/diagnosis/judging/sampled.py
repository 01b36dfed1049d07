"""A channel that was read at another time than its row says, or through a filter.

    the instant at which the simulation, taken there, comes nearest to the channel
    the low pass through which the simulated current comes nearest to the measured one

The one channel whose time or filter alone explains most of what is wrong is told, with what to
write in the map of an import, or in the rig's file.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.evidence import median_of
from servo_bench.diagnosis.comparing.rows import Rows
from servo_bench.diagnosis.reading.channels import ANGLES
from sim_rig.model import Model

CURRENT = "current_a"
TIMED = {
    "load_angle_rad": ("load's angle", "load_sampled"),
    "motor_position_rad": ("motor's angle", "motor_sampled"),
    CURRENT: ("torque or current", "current_sampled"),
}
"""What may be read at a time of its own; in words, and its role in a map."""
EARLIEST, LATEST = 1.0, -4.0
"""Periods after the row's time between which a sample is looked for."""
STEPS = (0.5, 0.25, 0.125)
LOW_PASSES, RATIOS = (0.0625, 32.0, 10), (1.4, 1.2, 1.1, 1.05, 1.025, 1.012)
"""Periods between which a low pass is looked for, and by what ratios its time is then bettered."""
FAR_NEARER = 0.5
"""Of its error, what a channel may keep where its time alone was wrong."""
LEAST_PERIODS = 0.03


class _Reading(NamedTuple):
    """A way in which a channel may have been read: the error of all signals with it, in floors;
    that of the channel's own ones with it and as it is; and how to say it."""

    error: float
    left: float
    now: float
    words: str


def as_read(comparison: Comparison, models: Sequence[Model]) -> Iterator[str]:
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
