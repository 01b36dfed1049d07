"""What a logger's own times and holes do to data from elsewhere, and how it is put right.

A host stamps rows when it gets round to it, while the drive goes by its own even clock; or the
stamps are right and the rows came unevenly. Only the motion tells: commands that last as long as
the stamps say walk the simulated angle off by their heights times the jitter. Both are played.

A row that was not written held a command that nobody knows. What the motor did over the hole and
after it tells: the hole gets a row without samples and the one command that leads there,

    de(t) = sum_j x_j h_j(t - t_j),    c_j <- c_j + x_j

de: increments of the measured angle less the simulated one, h_j: those of the ideal loop's for a
command of 1 rad/s for as long as that row lasts; x by least squares over all holes at once.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import lil_array
from scipy.sparse.linalg import lsqr

from servo_bench.diagnosis.comparing.playing import Source
from servo_bench.diagnosis.comparing.rows import HOLE_PERIODS, Array, rows_of, with_rows
from servo_bench.recording.recording import Recording
from sim_rig.model import Model

EVEN_S = 1e-6
"""Times that stray by less from an even clock are even."""
STRAYS = 0.5
"""Of a period, that a stamp may stray at most: else nobody knows which period it is of."""
HOLE = 1.5
"""Periods without a row that are a hole."""
MOST_HOLES = 0.02
"""Of the rows: beyond it there is more that nobody knows than is worth guessing."""
ANSWER_ROWS = 24
"""In which a loop has answered a hole's command."""
PASSES = 9
"""At most; between them it is played again, for friction makes the answer another one."""
COMMAND, ANGLE = "velocity_command_rad_s", "motor_position_rad"


def on_even_times(recording: Recording) -> Recording | None:
    """The recording on the even clock that is nearest to its stamps; None where there is none, or
    where they are even already, or where something better than stamps tells the times."""
    if "asked_ns" in recording or "t_s" not in recording or "run" in recording:
        return None
    t_s = np.asarray(recording["t_s"], np.float64)
    steps = np.rint(np.diff(t_s) / recording.period_s)
    if steps.size < 2 or not ((steps >= 1.0) & (steps <= HOLE_PERIODS)).all():
        return None
    slots = np.concatenate(([0.0], np.cumsum(steps)))
    period_s, first_s = np.polyfit(slots, t_s - t_s[0], 1)
    even_s = first_s + period_s * slots
    strays_s = np.abs(t_s - t_s[0] - even_s).max()
    if not EVEN_S < strays_s < STRAYS * period_s:
        return None
    channels = {**recording.channels, "t_s": t_s[0] + even_s}
    return replace(recording, channels=channels, period_s=float(period_s))


def jitter_s(recording: Recording, even: Recording) -> float:
    """Root mean square of the stamps about the even clock."""
    return float(np.std(recording["t_s"] - even["t_s"]))


def with_rows_in_holes(recording: Recording) -> tuple[Recording, tuple[int, ...]]:
    """With a row in every hole, a period after the last one before it, and where those rows are:
    the command goes on, floats did not come, and whole numbers are those of the row before."""
    holes = _holes(recording)
    if not holes:
        return recording, ()
    behind = np.array(holes) + 1
    own = {
        "t_s": recording["t_s"][holes] + recording.period_s,
        COMMAND: recording[COMMAND][holes],
    }
    rows = behind + np.arange(behind.size)
    return with_rows(recording, holes, behind.tolist(), own), tuple(rows.tolist())


def filled(recording: Recording, holes: Sequence[int], model: Model) -> Recording:
    """The recording with the commands of those rows that lead the model where the motor went."""
    if not holes:
        return recording
    nearest, least = recording, np.inf
    for _ in range(PASSES):
        lacking, left = _lacking(recording, model, holes)
        if left >= least:
            break
        nearest, least = recording, left
        commands = np.array(recording[COMMAND], np.float64)
        commands[list(holes)] += lacking
        recording = replace(recording, channels={**recording.channels, COMMAND: commands})
    return nearest


def _lacking(recording: Recording, model: Model, holes: Sequence[int]) -> tuple[Array, float]:
    """What the command of every hole lacks, shape (holes,), rad/s; and the error that stands where
    they are answered now."""
    rows = rows_of(recording)
    source, error, number = Source("loop", rows), _nothing(recording), _nothing(recording)
    for one, piece in enumerate(source.pieces(None)):
        shown = source.play(model, piece)[ANGLE]
        error[piece.rows], number[piece.rows] = rows.channel(ANGLE)[piece.rows] - shown, one
    known = np.flatnonzero(np.isfinite(error))
    joined = np.diff(number[known]) == 0.0
    wrong = np.where(joined, np.diff(error[known]), 0.0)
    answers = lil_array((wrong.size, len(holes)))
    for column, k in enumerate(holes):
        until = min(k + ANSWER_ROWS, error.size)
        answer = np.append(0.0, _answer(model, recording.period_s, float(rows.durations_s[k])))
        low, high = np.searchsorted(known, (k - 1, until))
        about = known[max(low - 1, 0) : high]
        moved = np.diff(answer[np.clip(about - k + 1, 0, answer.size - 1)])
        own = (number[about[1:]] == number[k]) & (number[about[:-1]] == number[k])
        first = max(low - 1, 0)
        answers[first : first + moved.size, [column]] = np.where(own, moved, 0.0)[:, None]
    answered = answers.tocsc()
    left = float(np.linalg.norm(wrong[np.unique(answered.indices)]))
    return np.asarray(lsqr(answered, wrong, atol=1e-12, btol=1e-12)[0]), left


def _nothing(recording: Recording) -> Array:
    return np.full(len(recording), np.nan)


def _answer(model: Model, period_s: float, hole_s: float) -> Array:
    """The ideal loop's motor angle from a hole's row on, shape (ANSWER_ROWS,), rad."""
    command, lasted_s = np.zeros(ANSWER_ROWS), np.full(ANSWER_ROWS, period_s)
    command[0], lasted_s[0] = 1.0, hole_s
    ideal = Model(model.nominal, longest_step_s=model.longest_step_s)
    return ideal.simulate(command, lasted_s).motor_angle_rad


def _holes(recording: Recording) -> list[int]:
    """Rows behind which one or more are missing; none where the motor's way is not known: what
    the load did in its gap tells of no command."""
    names = recording.channels
    if "asked_ns" in names or not {"t_s", COMMAND, ANGLE} <= set(names):
        return []
    rows = rows_of(recording)
    if not rows.has(ANGLE):
        return []
    hole = (rows.durations_s > HOLE * rows.period_s) & ~rows.broken
    found: list[int] = np.flatnonzero(hole).tolist()
    return found if len(found) <= MOST_HOLES * len(recording) else []
