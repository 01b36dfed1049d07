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
from servo_bench.diagnosis.rows import Array
from sim_rig.model import Model

ANGLES = {"motor_position_rad": "motor's angle", "load_angle_rad": "load's angle"}
CURRENT = "current_a"
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
    period_ms = comparison.source.rows.period_s * 1e3
    for name, what, signal, role in (
        ("load_angle_rad", "load's angle", "load_angle_rad", "load_sampled"),
        (CURRENT, "torque or current", "", "current_sampled"),
    ):
        rows = [
            k
            for k, s in enumerate(comparison.signals)
            if (s.channel == signal if signal else s.simulated == CURRENT)
        ]
        if not rows or (signal and not comparison.source.rows.has("motor_position_rad")):
            continue
        left, now, after, told = min(_nearest(comparison, model, name, rows) for model in models)
        share = left / max(now, 1e-30)
        if share < FAR_NEARER and abs(after - told) > LEAST_PERIODS:
            yield (
                f"The {what} comes {1.0 / max(share, 1e-3):.2g} times nearer to the simulation if "
                f"sampled {after * period_ms:+.3g} ms after its row's time: is it read late, or "
                f'filtered? In the map of an import role = "{role}", value = '
                f'{after * period_ms:.3g}, unit = "ms" says so.'
            )


def _nearest(
    comparison: Comparison, model: Model, name: str, signals: list[int]
) -> tuple[float, float, float, float]:
    """Its error at the instant where it is least and at its own, in floors; and both instants, in
    periods after the rows' times."""

    def error(after: float) -> float:
        rows = comparison.source.rows
        told = {**rows.after_s, name: np.full(len(rows.t_s), after * rows.period_s)}
        source = comparison.source._replace(rows=replace(rows, after_s=told))
        left = replace(comparison, source=source).errors(model)[signals]
        known = np.where(comparison.seen, left, np.nan)
        sizes = np.array([comparison.signals[k].floor for k in signals])
        return float(np.nansum(np.nanmedian(np.abs(known), axis=1) / sizes))

    own = comparison.source.rows.after_s.get(name)
    now = float(np.median(own)) / comparison.source.rows.period_s if own is not None else 0.0
    tried = {after: error(after) for after in np.arange(LATEST, EARLIEST + 0.1, STEPS[0]).tolist()}
    tried[now] = error(now)
    for step in STEPS[1:]:
        best = min(tried, key=tried.__getitem__)
        tried |= {after: error(after) for after in (best - step, best + step)}
    best = min(tried, key=tried.__getitem__)
    return tried[best], tried[now], best, now
