"""A recording whose commands are held for several rows, as one with fewer rows to a command.

What a diagnosis weighs, and what it may miss, is known of rows of some milliseconds; rows in which
the command cannot have changed add time more than knowledge. So every r-th row is kept, with r the
most rows that no change of a command falls between and that last `LONGEST_S` at most. A change
that comes beside the others (its row was skipped) is kept in the mean of what was commanded over
the row: the angle's integral stays.

Only the closed loop is thinned: what is played from a measured current or angle needs every row.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from servo_bench.diagnosis.comparing.rows import HOLE_PERIODS, with_rows
from servo_bench.recording.recording import Recording

LONGEST_S = 0.010
"""Of the rows that are kept."""
IN_STEP, FEWEST_CHANGES = 0.98, 20
"""Share of a recording's changes that fall in step, and how many there must be to say so."""
COMMAND = "velocity_command_rad_s"
ANGLES = ("motor_position_rad", "load_angle_rad")

Slots = NDArray[np.int64]


def rows_to_a_command(recordings: Sequence[Recording]) -> int:
    """How many rows of all these recordings can be one; 1 where their rows are no faster."""
    periods = {recording.period_s for recording in recordings}
    if len(periods) != 1 or not all(_can_be_thinned(recording) for recording in recordings):
        return 1
    changes = [_changes(recording) for recording in recordings]
    if sum(slots.size for slots in changes) < FEWEST_CHANGES:
        return 1
    most = int(LONGEST_S / periods.pop() * (1.0 + 1e-9))
    fits = (r for r in range(most, 1, -1) if all(_in_step(slots, r) for slots in changes))
    return next(fits, 1)


def thinned(recording: Recording, rows: int) -> Recording:
    """Of every so many rows one; the recording as it is where its own commands are not in step."""
    if rows == 1 or not _can_be_thinned(recording):
        return recording
    changes = _changes(recording)
    if not _in_step(changes, rows):
        return recording
    first = int(np.bincount(changes % rows).argmax()) if changes.size else 0
    recording = _with_first_rows(recording, first, rows)
    slots = _slots(recording)
    kept = np.flatnonzero((slots - first) % rows == 0)
    channels = {name: values[kept] for name, values in recording.channels.items()}
    channels[COMMAND] = _means(np.asarray(recording[COMMAND], np.float64), slots, kept)
    channels["slot"] = (slots[kept] - first) // rows
    period_s = rows * recording.period_s
    return replace(recording, channels=channels, period_s=period_s, experiment=None, fast={})


def _with_first_rows(recording: Recording, first: int, rows: int) -> Recording:
    """With a row where the one to be kept is missing and others of its command came: the command
    is theirs, and its samples did not come.

    Of a run's skipped slot the command before is held, and its row stays missing.
    """
    if "asked_ns" in recording or "t_s" not in recording:
        return recording
    slots = _slots(recording)
    group = (slots - first) // rows
    opens = np.flatnonzero((np.diff(group, prepend=group[0]) > 0) & ((slots - first) % rows != 0))
    behind = (slots[opens] - first) % rows
    own = {
        "t_s": recording["t_s"][opens] - recording.period_s * behind,
        "slot": slots[opens] - behind,
        COMMAND: recording[COMMAND][opens],
    }
    return with_rows(recording, opens.tolist(), opens.tolist(), own)


def _can_be_thinned(recording: Recording) -> bool:
    """Whether the loop is played from it, whole, and its rows can be numbered."""
    if COMMAND not in recording or "run" in recording or len(recording) < 2:
        return False
    shown = [np.asarray(recording[name], np.float64) for name in ANGLES if name in recording]
    if not any(np.isfinite(angle).any() for angle in shown) or not recording.period_s > 0.0:
        return False
    steps = np.diff(_slots(recording))
    cut = "asked_ns" not in recording and (steps > HOLE_PERIODS).any()
    return not cut and bool((steps >= 1).all())


def _slots(recording: Recording) -> Slots:
    """The slot of each row; where it is not told, from the times between them."""
    if "slot" in recording:
        return np.asarray(recording["slot"], np.int64)
    if "t_s" not in recording:
        return np.arange(len(recording), dtype=np.int64)
    steps = np.diff(np.asarray(recording["t_s"], np.float64)) / recording.period_s
    return np.concatenate(([0], np.cumsum(np.rint(np.nan_to_num(steps)).astype(np.int64))))


def _changes(recording: Recording) -> Slots:
    """Slots at which the command changed between neighbours: in a hole it changed anywhere."""
    slots = _slots(recording)
    jumps = np.nan_to_num(np.diff(np.asarray(recording[COMMAND], np.float64)))
    return np.asarray(slots[1:][(jumps != 0.0) & (np.diff(slots) == 1)])


def _in_step(changes: Slots, rows: int) -> bool:
    """Whether nearly all of them are multiples of so many slots apart."""
    if not changes.size:
        return True
    return bool(np.bincount(changes % rows).max() >= IN_STEP * changes.size)


def _means(
    commands: NDArray[np.float64], slots: Slots, kept: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Over each kept row until the next: the one command, or the mean of those that came."""
    until = np.append(slots[kept[1:]], slots[-1] + 1)
    lasted = np.diff(np.append(slots, slots[-1] + 1)).astype(np.float64)
    total = np.add.reduceat(commands * lasted, kept)
    lowest, highest = np.minimum.reduceat(commands, kept), np.maximum.reduceat(commands, kept)
    return np.where(lowest == highest, lowest, total / (until - slots[kept]))
