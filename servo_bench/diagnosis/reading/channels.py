"""An angle that is counted another way than the rig's file says, or another shaft's.

    measured increments over the simulated ones     sign, counts per revolution, gear
    the measured twist, turned round                motor and load exchanged
    steps of one size that do not come back at once     told within a turn only
    increments of a row, some rows before the simulated     commands that were logged late

A loop with an integrator turns as far as it is told, whatever rubs or gives way: no physics makes
these, and nothing can be told of any while they last.
"""

from collections.abc import Iterator

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.rows import Array
from sim_rig.model import Model

ANGLES = {"motor_position_rad": "motor's angle", "load_angle_rad": "load's angle"}
ONE_SCALE = 0.15
LONG_ROWS = 12
"""Of increments that a gap or a loop's answer hardly changes."""
ALIKE, ANOTHER_SIZE = 0.9, 0.3
"""Correlation of a channel that is the rig's but for its scale; and how far that is from one."""
HALF_A_WRAP, LEAST_WRAP_RAD, FEWEST_WRAPS = 0.5, 1.0, 3
WRAP_SCATTER, FAR_BELOW, BACK_ROWS = 0.02, 0.2, 4
"""Of a wrap: its steps beside each other and beside any motion in a row; rows in which a spoilt
word is right again."""
MOST_AHEAD, AHEAD = 4, 0.5
"""Rows by which commands are looked for late; and of an increment's error, what is left then."""
EXCHANGED, OPPOSED = 0.5, -0.6
"""Of the twist's error as it is, what is left of it turned round; and its correlation with what it
should be, at most. A heavy load that hangs in its gap is on another side than the simulated one,
for half of the error, and not on the other side whenever that turns (0.0; exchanged: -0.88, -0.97).
"""


def wrong_angles(comparison: Comparison, model: Model) -> Iterator[str]:
    """What is so of an angle of a closed loop's recording, one sentence for each."""
    if comparison.block != "loop":
        return
    wraps = tuple(_wraps(comparison))
    yield from wraps
    if wraps or commanded_scale(comparison, model) is not None:
        return
    scaled = dict(_scales(comparison, model))
    for channel, scale in scaled.items():
        yield (
            f"The {ANGLES[channel]} moves {scale:.3g} times as far as the rig's would: look at its "
            "sign, its counts per revolution, and the gear between."
        )
    if not scaled and _are_exchanged(comparison, model):
        yield (
            "The load's angle moves as the motor's should, and the motor's as the load's: exchange "
            "the two channels, or the encoders' lines."
        )
        return
    rows = rows_ahead(comparison, model)
    if rows and not scaled:
        yield (
            f"The motion comes {rows} {'row' if rows == 1 else 'rows'} before the command that "
            "asks for it: commands are logged late. Shift them against the angles."
        )


def _wraps(comparison: Comparison) -> Iterator[str]:
    for channel, words in ANGLES.items():
        if not comparison.source.rows.has(channel):
            continue
        values = comparison.source.rows.channel(channel)
        steps = wrap_steps(values[np.isfinite(values)])
        if steps.size:
            size = float(np.median(np.abs(steps)))
            yield (
                f"The {words} goes back by {size:.4g} rad, {steps.size} times: it is told within a "
                "turn only. Unwrap it (unwrap = true in the map of an import)."
            )


def wrap_steps(angle_rad: Array) -> Array:
    """Steps of an angle that is told within a turn, where there are any: all of one size, far
    beyond every other, and all of the angle within one of them. Most spoilt words go back with the
    next rows; an angle that rests where it wraps does so now and then."""
    steps = np.diff(angle_rad)
    sizes = np.abs(steps)
    largest = float(sizes.max(initial=0.0))
    at = np.flatnonzero(sizes > HALF_A_WRAP * largest)
    if largest < LEAST_WRAP_RAD or at.size < FEWEST_WRAPS:
        return steps[:0]
    motion = float(np.delete(sizes, at).max(initial=0.0))
    within = float(np.ptp(angle_rad)) < largest + 2.0 * motion
    alike = float(np.ptp(sizes[at])) < 2.0 * motion + WRAP_SCATTER * largest
    backs = np.count_nonzero(np.diff(at) <= BACK_ROWS)
    stays = backs < HALF_A_WRAP * (at.size - 1)
    return steps[at] if within and alike and stays and motion < FAR_BELOW * largest else steps[:0]


def rows_ahead(comparison: Comparison, model: Model) -> int:
    """So many rows before the command that asks for it every angle moves; 0 where none does.

    What comes late is a cause (`transport_delay`); nothing moves before it is told to. One angle
    alone that is ahead of the other was read after its row's time (`sampled`).
    """
    came = [name for name in ANGLES if comparison.source.rows.has(name)]
    left = [_left_by_rows(comparison, model, channel) for channel in came]
    best = {int(np.argmin(one)) for one in left}
    much = min((float(one.min() / one[0]) for one in left), default=1.0) < AHEAD
    return best.pop() if len(best) == 1 and much else 0


def _left_by_rows(comparison: Comparison, model: Model, channel: str) -> Array:
    """The increments' error beside a simulation that is so many rows ahead, shape (rows + 1,)."""
    measured, shown = _increments(comparison, model, channel, rows=1)
    end = measured.size - MOST_AHEAD
    if end <= MOST_AHEAD:
        return np.ones(1)
    shifted = [measured[:end] - shown[k : k + end] for k in range(MOST_AHEAD + 1)]
    return np.asarray(np.maximum(np.median(np.abs(shifted), axis=1), 1e-30), np.float64)


def commanded_scale(comparison: Comparison, model: Model) -> float | None:
    """So many times as far as the command asks both angles move, where that is not once."""
    scales = [scale for _, scale in _scales(comparison, model)]
    one = len(scales) == len(ANGLES) and np.ptp(scales) < ONE_SCALE * np.abs(scales).max()
    return float(np.mean(scales)) if one else None


def _scales(comparison: Comparison, model: Model) -> Iterator[tuple[str, float]]:
    for channel in ANGLES:
        if not comparison.source.rows.has(channel):
            continue
        scale = another_size(*_increments(comparison, model, channel))
        if scale is not None:
            yield channel, scale


def another_size(measured: Array, shown: Array) -> float | None:
    """The one over the other, where they are alike but for that, and it is far from one."""
    size = float(shown @ shown)
    alike = float(measured @ shown) / max(np.sqrt(size * float(measured @ measured)), 1e-30)
    scale = float(measured @ shown) / max(size, 1e-30)
    return scale if abs(alike) > ALIKE and abs(scale - 1.0) > ANOTHER_SIZE else None


def _are_exchanged(comparison: Comparison, model: Model) -> bool:
    """Whether the measured twist is the simulated one turned round."""
    if not all(comparison.source.rows.has(channel) for channel in ANGLES):
        return False
    motor, load = (values_of(comparison, model, channel, channel) for channel in ANGLES)
    if not motor[0].size:
        return False
    measured, shown = (one - np.median(one) for one in (load[0] - motor[0], load[1] - motor[1]))
    as_it_is, turned = (float(np.median(np.abs(measured - k * shown))) for k in (1.0, -1.0))
    size = np.sqrt(float(shown @ shown) * float(measured @ measured))
    return turned < EXCHANGED * as_it_is and float(measured @ shown) < OPPOSED * size


def values_of(
    comparison: Comparison, model: Model, channel: str, simulated: str
) -> tuple[Array, Array]:
    """What was measured and what is simulated, in the rows in which every angle and it came."""
    rows = comparison.source.rows
    names = [n for n in (*ANGLES, channel) if rows.has(n)]
    found = []
    for points in comparison.pieces:
        at = points.piece.rows
        came = np.logical_and.reduce([np.isfinite(rows.channel(n)[at]) for n in names])
        shown = comparison.source.play(model, points.piece)[simulated]
        found.append(np.stack([rows.channel(channel)[at], shown])[:, came])
    measured, played = np.concatenate(found, axis=1)
    return measured, played


def _increments(
    comparison: Comparison, model: Model, channel: str, rows: int = LONG_ROWS
) -> tuple[Array, Array]:
    found = []
    for points in comparison.pieces:
        shown = comparison.source.play(model, points.piece)[channel]
        came = comparison.source.rows.channel(channel)[points.piece.rows]
        both = np.stack([came[rows:] - came[:-rows], shown[rows:] - shown[:-rows]])
        found.append(both[:, np.isfinite(both).all(axis=0)])
    measured, simulated = np.concatenate(found, axis=1)
    return measured, simulated
