"""A recording whose commands are held for several rows, as one of a row to every command.

What a diagnosis weighs, and what it may miss, is known of rows of some milliseconds; rows in which
the command cannot have changed add time more than knowledge. So every r-th row is kept, with r the
most rows that no change of the command falls between and that last `LONGEST_S` at most. A command
that came late all the same (its row was skipped) is the mean of what was asked over the row: the
angle's integral stays.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from servo_bench.kernels.response import slot_numbers
from servo_bench.recording.recording import Recording

LONGEST_S = 0.010
"""Of the rows that are kept."""
COMMAND = "velocity_command_rad_s"


def thinned(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """The same recordings with a row to a command, all alike; as they are where one cannot be."""
    held = [_Held.of(recording) for recording in recordings]
    shortest_s = min(recording.period_s for recording in recordings)
    most = int(LONGEST_S / shortest_s * (1.0 + 1e-9))
    apart = int(np.gcd.reduce([one.apart for one in held]))
    rows = max((r for r in range(1, most + 1) if apart % r == 0), default=1)
    if rows == 1 or apart == 0:
        return tuple(recordings)
    pairs = zip(recordings, held, strict=True)
    return tuple(_thinned(recording, rows, one.first) for recording, one in pairs)


class _Held(NamedTuple):
    """Every change of a command comes a multiple of `apart` slots after slot `first`; one where
    that is not known, none where nothing changes."""

    apart: int
    first: int

    @classmethod
    def of(cls, recording: Recording) -> "_Held":
        """By the changes between neighbours: what changed in a hole changed anywhere in it."""
        slots = slot_numbers(recording)
        if COMMAND not in recording or "run" in recording or (np.diff(slots) < 1).any():
            return cls(1, 0)
        commands = np.asarray(recording[COMMAND], np.float64)
        if not np.isfinite(commands).all():
            return cls(1, 0)
        changes = slots[1:][(np.diff(commands) != 0.0) & (np.diff(slots) == 1)]
        if not changes.size:
            return cls(0, int(slots[0]) if slots.size else 0)
        return cls(int(np.gcd.reduce(np.diff(changes))), int(changes[0]))


def _thinned(recording: Recording, rows: int, first: int) -> Recording:
    """One of so many rows is kept, those of slot `first` among them."""
    slots = slot_numbers(recording)
    commands = np.asarray(recording[COMMAND], np.float64)
    kept = np.flatnonzero((slots - first) % rows == 0)
    channels = {name: values[kept] for name, values in recording.channels.items()}
    channels[COMMAND] = _means(commands, slots, kept)
    channels["slot"] = (slots[kept] - first) // rows
    period_s = rows * recording.period_s
    return replace(recording, channels=channels, period_s=period_s, experiment=None)


def _means(
    commands: NDArray[np.float64], slots: NDArray[np.int64], kept: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Over each kept row until the next: the one command, or the mean of those that came."""
    until = np.append(slots[kept[1:]], slots[-1] + 1)
    lasted = np.diff(np.append(slots, slots[-1] + 1)).astype(np.float64)
    total = np.add.reduceat(commands * lasted, kept)
    lowest, highest = np.minimum.reduceat(commands, kept), np.maximum.reduceat(commands, kept)
    return np.where(lowest == highest, lowest, total / (until - slots[kept]))
