"""Whether what judges was recorded apart from what was fitted, and under another excitation.

A gain on the very rows that a fit saw is no evidence, and one under the same commands little: what
a wrong model misses there may be what its numbers were fitted to.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.judging.undecided import COMMAND
from servo_bench.errors import ConfigError
from servo_bench.recording.recording import Recording

ALIKE = 1e-6
"""Of the largest command: how a number is written in a file."""


def check_apart(recordings: Sequence[Recording], held_out: Recording | None) -> None:
    """ConfigError where a recording is given twice, or is to judge what was fitted to it."""
    for number, one in enumerate(recordings, 1):
        for earlier, other in enumerate(recordings[: number - 1], 1):
            if _are_one(one, other):
                raise ConfigError(
                    f"recordings {earlier} and {number} are the same rows: they would count twice. "
                    "Give each once."
                )
        if held_out is not None and _are_one(one, held_out):
            raise ConfigError(
                f"the held-out recording and recording {number} are the same rows: a gain there is "
                "one that a fit has seen. Record another sequence, or hold nothing out: the "
                "validation, or the last quarter, judges then."
            )


def same_commands(recordings: Sequence[Recording], held_out: Recording | None) -> Iterator[str]:
    """What a held-out recording leaves open that has the commands of one that was fitted."""
    if held_out is not None and any(_play_the_same(one, held_out) for one in recordings):
        yield (
            "The held-out recording has the commands of one that was fitted: its gain says nothing "
            "of another excitation. Record another sequence to judge by."
        )


def _are_one(one: Recording, other: Recording) -> bool:
    if len(one) != len(other) or set(one.channels) != set(other.channels):
        return False
    return all(np.array_equal(one[n], other[n], equal_nan=True) for n in one.channels)


def _play_the_same(one: Recording, other: Recording) -> bool:
    """Whether one's commands are the other's, as far as the shorter goes."""
    first, second = _moving(one), _moving(other)
    shorter = min(first.size, second.size)
    if not shorter:
        return False
    most = ALIKE * float(np.abs(first).max())
    return bool(np.allclose(first[:shorter], second[:shorter], rtol=0.0, atol=most))


def _moving(recording: Recording) -> Array:
    """The commands from the first that moves the axis to the last."""
    if COMMAND not in recording:
        return np.zeros(0)
    command = np.nan_to_num(np.asarray(recording[COMMAND], np.float64))
    moves = np.flatnonzero(command)
    return command[moves[0] : moves[-1] + 1] if moves.size else command[:0]
