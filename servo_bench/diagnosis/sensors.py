"""What a channel is that no rig makes so: counted the other way, or read at another time.

Nobody's physics is wrong then, and no effect explains it. So it is looked for where nothing else
explained the error, and told in words: what it looks like, and what to write in the map.

    measured increments over the simulated ones     sign, counts per revolution, gear
    the instant at which the simulation, taken there, comes nearest to the channel
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from servo_bench.diagnosis.comparison import Comparison
from servo_bench.diagnosis.evidence import median_of
from servo_bench.diagnosis.rows import Array
from sim_rig.model import Model

ANGLES = {"motor_position_rad": "motor's angle", "load_angle_rad": "load's angle"}
CURRENT = "current_a"
TIMED = {
    "load_angle_rad": ("load's angle", "load_sampled"),
    "motor_position_rad": ("motor's angle", "motor_sampled"),
    CURRENT: ("torque or current", "current_sampled"),
}
"""What may be read at a time of its own; in words, and its role in a map."""
LONG_ROWS = 12
"""Of increments that a gap or a loop's answer hardly changes."""
ALIKE, ANOTHER_SIZE = 0.9, 0.3
"""Correlation of a channel that is the rig's but for its scale; and how far that is from one."""
EARLIEST, LATEST = 1.0, -4.0
"""Periods after the row's time between which a sample is looked for."""
STEPS = (0.5, 0.25, 0.125)
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
    for channel, scale in scaled.items():
        yield (
            f"The {ANGLES[channel]} moves {scale:.3g} times as far as the rig's would: look at its "
            "sign, its counts per revolution, and the gear between."
        )
    if not scaled:
        yield from _beside_their_time(comparison, (nominal, found))


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


def _beside_their_time(comparison: Comparison, models: Sequence[Model]) -> Iterator[str]:
    """The one channel whose time alone explains most, if that is much."""
    named = {signal.simulated for signal in comparison.signals}
    named |= {signal.less for signal in comparison.signals if signal.less}
    if ANGLES.keys() & named != ANGLES.keys():
        return  # of one angle alone a late sensor is a late command
    nearest = (
        (*_nearest(comparison, model, channel), channel)
        for channel in TIMED
        if channel in named
        for model in models
    )
    _, left, now, after, told, channel = min(nearest)
    what, role = TIMED[channel]
    period_ms = comparison.source.rows.period_s * 1e3
    if left < FAR_NEARER * now and abs(after - told) > LEAST_PERIODS:
        yield (
            f"It is {now / max(left, 1e-3):.2g} times nearer to the simulation if the {what} was "
            f"sampled {abs(after) * period_ms:.3g} ms {'before' if after < 0.0 else 'after'} its "
            "row's time: is it late, or filtered? In the map of an import "
            f'role = "{role}", value = {after * period_ms:.3g}, unit = "ms" says so.'
        )


def _nearest(
    comparison: Comparison, model: Model, channel: str
) -> tuple[float, float, float, float, float]:
    """The error of all signals, in floors, where the channel's instant makes it least; that of its
    own ones there and as it is; and both instants, in periods after the rows' times."""
    own = [channel in {signal.simulated, signal.less} for signal in comparison.signals]

    def error(after: float) -> tuple[float, float]:
        rows = comparison.source.rows
        told = {**rows.after_s, channel: np.full(len(rows.t_s), after * rows.period_s)}
        if channel == "motor_position_rad":  # the current has its own instant all the same
            told.setdefault("current_a", np.full(len(rows.t_s), _own(comparison, "current_a")))
        source = comparison.source._replace(rows=replace(rows, after_s=told))
        (shown,) = replace(comparison, source=source).errors_of([model])
        if not np.isfinite(shown).any():  # so late a sample cannot be played
            return np.inf, np.inf
        known = np.where(comparison.seen, shown, np.nan)
        sizes = np.array([signal.floor for signal in comparison.signals])
        each = np.array([median_of(np.abs(row)) for row in known / sizes[:, None]])
        return float(each.sum()), float(each[own].sum())

    now = _own(comparison, channel) / comparison.source.rows.period_s
    tried = {after: error(after) for after in np.arange(LATEST, EARLIEST + 0.1, STEPS[0]).tolist()}
    tried[now] = error(now)
    for step in STEPS[1:]:
        best = min(tried, key=tried.__getitem__)
        tried |= {after: error(after) for after in (best - step, best + step)}
    best = min(tried, key=tried.__getitem__)
    return *tried[best], tried[now][1], best, now


def _own(comparison: Comparison, channel: str) -> float:
    """The instant at which the channel is compared already, s after its row's time."""
    after_s = comparison.source.rows.after_s
    motor = "motor_position_rad" if channel == CURRENT else channel
    told = after_s.get(channel, after_s.get(motor))
    return float(np.median(told)) if told is not None else 0.0
