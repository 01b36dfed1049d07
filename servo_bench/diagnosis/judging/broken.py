"""A channel that its sensor or its line has broken: it stands, jumps, or is silent.

Robust fits pass over the rows of it, and would say that nothing is wrong. No model is asked here:

    stands   an angle stays within `STILL_RAD` while the commands of that time turn the axis farther
             than a gap, friction, and a lag hide
    jumps    from a row to the next it leaves the motor's angle (or, where that did not come, the
             command's integral) by more than a gap, a resonance, and the loop's lag allow, and
             stays there
    silent   a torque or current is the same to the last digit through many commands

A word that is spoilt and right again in the next rows is no jump (`hygiene.wild_samples`), and one
that is of another size jumps all the time (`channels`).
"""

from collections.abc import Iterator, Sequence
from itertools import islice, pairwise
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from servo_bench.diagnosis.comparing.rows import Array, rows_of
from servo_bench.diagnosis.judging.undecided import COMMAND, EFFORTS
from servo_bench.errors import FitError
from servo_bench.recording.recording import Recording

MOTOR, LOAD = "motor_position_rad", "load_angle_rad"
WORDS = {MOTOR: "motor's", LOAD: "load's"}
STILL_RAD, TURNED_RAD = 2e-3, 1.0
"""Less than any motion under a command, and more than any noise; and what was commanded."""
SILENT_S, CHANGES = 1.0, 40
"""So long, through so many changes of the command, no torque is the same: not one that is told in
hundredths of its rated value, nor one at its limit."""
GAPS, APART_RAD, LAG_ROWS = 2.0, 0.02, 3.0
"""Of a jump: beyond so many gaps and so much, and, beside the command's integral, as many rows at
the largest command."""
STAYS_ROWS, STAYS = 20, 0.7
MOST_JUMPS = 5


class _Rows(NamedTuple):
    """Rows in which all of some angles came, with the commands' integral there, what each row's
    command asks for, and their times."""

    angles: tuple[Array, ...]
    commanded: Array
    asked: Array
    time_s: Array


class Rig(NamedTuple):
    """What is known of a rig: its gap; a command up to which it stands; and how far the command's
    integral leads a shaft that friction holds, T/(K_T K_I) with the rig's own torque T."""

    gap_rad: float
    deadband_rad_s: float = 0.0
    held_rad: float = 0.0

    @property
    def hidden_rad(self) -> float:
        """So much may be commanded, and nothing seen to turn."""
        return GAPS * (self.gap_rad + self.held_rad)


def broken(recordings: Sequence[Recording], held_out: Recording | None, rig: Rig) -> Iterator[str]:
    """What stands, and what jumps, one sentence for each."""
    for number, one in enumerate(recordings, 1):
        yield from _of_one(one, rig, f" in recording {number}" if len(recordings) > 1 else "")
    if held_out is not None:
        yield from _of_one(held_out, rig, " in the held-out recording")


def _of_one(recording: Recording, rig: Rig, where: str) -> Iterator[str]:
    """What comes back after it stood has jumped as well, which nobody needs to be told."""
    stand = list[str]()
    for channel in (LOAD, MOTOR):
        parts = _parts_of(recording, channel, deadband_rad_s=rig.deadband_rad_s)
        stand += islice((said for rows in parts for said in _stands(rows, channel, rig, where)), 1)
    yield from stand or _jumps(recording, rig.gap_rad, where)
    names = [n for n in EFFORTS if n in recording and COMMAND in recording]
    silent = (said for name in names for said in _silent(recording, name, where))
    yield from islice(silent, 1)  # a current is its torque over K_T, or the other way about


def _stands(rows: _Rows, channel: str, rig: Rig, where: str) -> Iterator[str]:
    stays = list(_stays(rows.angles[0]))
    turned = [float(np.ptp(rows.commanded[first : last + 1])) for first, last in stays]
    longest = int(np.argmax(turned))
    if turned[longest] < TURNED_RAD + rig.hidden_rad:
        return
    began, ended = (float(rows.time_s[row]) for row in stays[longest])
    yield (
        f"The {WORDS[channel]} angle stood still for {ended - began:.3g} s from {began:.4g} s on"
        f"{where}, while the commands asked for {turned[longest]:.3g} rad: look at the encoder and "
        "its line, and whether the axis was free to turn."
    )


def _stays(angle: Array) -> Iterator[tuple[int, int]]:
    """First and last rows, one after the other, between which it stays within `STILL_RAD`."""
    first, low, high = 0, np.inf, -np.inf
    for row, value in enumerate(angle):
        low, high = min(low, value), max(high, value)
        if high - low > STILL_RAD:
            yield first, row - 1
            first, low, high = row, value, value
    yield first, angle.size - 1


def _silent(recording: Recording, name: str, where: str) -> Iterator[str]:
    told = np.asarray(recording[name], np.float64)
    came = np.isfinite(told)
    changed = np.diff(np.asarray(recording[COMMAND], np.float64), prepend=0.0) != 0.0
    changes, rows = np.cumsum(changed)[came], np.flatnonzero(came)
    if not rows.size:
        return
    ends = np.flatnonzero(np.append(np.diff(told[came]) != 0.0, True))
    firsts = np.concatenate(([0], ends[:-1] + 1))
    heard = changes[ends] - changes[firsts]
    lasted_s = recording.period_s * (rows[ends] - rows[firsts])
    longest = int(np.argmax(heard))
    if heard[longest] >= CHANGES and lasted_s[longest] > SILENT_S:
        word = "torque" if "torque" in name else "current"
        yield (
            f"The drive's {word} stays at {told[came][ends[longest]]:.3g} for "
            f"{lasted_s[longest]:.3g} s{where}, through {heard[longest]} changes of the command: "
            "it says nothing there. Look at how it is read."
        )


def _jumps(recording: Recording, gap_rad: float, where: str) -> Iterator[str]:
    parts = _parts_of(recording, LOAD, MOTOR) or _parts_of(recording, LOAD)
    yield from islice((said for rows in parts for said in _jumped(rows, gap_rad, where)), 1)


def _jumped(rows: _Rows, gap_rad: float, where: str) -> Iterator[str]:
    lag_rad = 0.0 if len(rows.angles) > 1 else LAG_ROWS * float(np.abs(rows.asked).max())
    beside = rows.angles[1] if len(rows.angles) > 1 else rows.commanded
    apart = rows.angles[0] - beside
    found = _steps_of(apart, GAPS * gap_rad + APART_RAD + lag_rad)
    if not 0 < len(found) <= MOST_JUMPS:
        return
    row = max(found, key=lambda k: abs(apart[k + 1] - apart[k]))
    more = f", and {len(found) - 1} times more" if len(found) > 1 else ""
    yield (
        f"The load's angle jumped by {apart[row + 1] - apart[row]:+.3g} rad at "
        f"{rows.time_s[row + 1]:.4g} s{where}{more}, and stayed there: counts were lost or set, or "
        "the coupling slipped."
    )


def _steps_of(apart: Array, least_rad: float) -> list[int]:
    """Rows after which it is elsewhere, and stays."""
    middle = np.median(sliding_window_view(apart, STAYS_ROWS), axis=1)
    found = list[int]()
    for row in map(int, np.flatnonzero(np.abs(np.diff(apart)) > least_rad)):
        if STAYS_ROWS - 1 <= row < apart.size - STAYS_ROWS:
            went = middle[row + 1] - middle[row - STAYS_ROWS + 1]
            found += [row] if went / (apart[row + 1] - apart[row]) > STAYS else []
    return found


def _parts_of(
    recording: Recording, *channels: str, deadband_rad_s: float = 0.0
) -> tuple[_Rows, ...]:
    """The rows in which all of these angles came, where enough did, beside commands above that;
    apart where nothing says what was commanded between two of them."""
    if any(name not in recording for name in (*channels, COMMAND)):
        return ()
    try:
        rows = rows_of(recording)
    except FitError:  # said elsewhere: times that do not rise, or hardly a row
        return ()
    angles = np.stack([rows.channel(name) for name in channels])
    command = rows.channel(COMMAND)
    heard = np.where(np.isfinite(command) & (np.abs(command) > deadband_rad_s), command, 0.0)
    asked = heard * rows.durations_s
    commanded = np.cumsum(asked) - asked  # a row's angle is taken before its own command acts
    ends = [0, *(np.flatnonzero(rows.broken) + 1).tolist()]
    found = []
    for first, last in pairwise(ends):
        came = first + np.flatnonzero(np.isfinite(angles[:, first:last]).all(axis=0))
        if came.size >= 2 * STAYS_ROWS:
            kept = tuple(angles[:, came])
            found.append(_Rows(kept, commanded[came], asked[came], rows.t_s[came]))
    return tuple(found)
