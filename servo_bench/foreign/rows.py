"""Which rows of a foreign file are kept, and when they were sampled. Nothing is resampled.

Every row that goes, and every time that is moved, is counted in a note; without the map's leave
none goes and none is moved.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import RecordingError
from servo_bench.foreign.maps import RunsMap, Window

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

LATEST_S = 4e9
"""Beyond the year 2096 as seconds since 1970; a time above it has another unit."""


@dataclass(frozen=True, slots=True)
class Note:
    """What was done to the data: `count` rows, in words."""

    count: int
    text: str


@dataclass(frozen=True, slots=True)
class Timed:
    """Rows that are kept, as indices into the file's rows, and their times in seconds."""

    rows: Rows
    t_s: Array


class Source(NamedTuple):
    """The file, for messages, and where the reader finds a row in it."""

    file: str
    place: Callable[[int], str]

    def at(self, row: int) -> str:
        """The file and the row's place in it."""
        return f"{self.file}, {self.place(row)}"


def run_numbers(values: Array, runs: RunsMap, source: Source) -> NDArray[np.int64]:
    """The run of every row, shape (rows,).

    Raises RecordingError where one is no whole number, comes twice, or a kept one is missing.
    """
    whole = np.isfinite(values) & (np.abs(values) < 2.0**53)
    whole &= np.where(whole, values, 0.0) == np.trunc(np.where(whole, values, 0.0))
    if not whole.all():
        row = int(np.argmin(whole))
        raise RecordingError(
            f"{source.at(row)}: the run is {values[row]} in column {runs.column!r}, and must "
            "be a whole number."
        )
    numbers = values.astype(np.int64)
    starts = np.flatnonzero(np.diff(numbers, prepend=numbers[:1] - 1))
    again = [at for k, at in enumerate(starts) if numbers[at] in numbers[starts[:k]]]
    if again:
        raise RecordingError(
            f"{source.at(int(again[0]))}: run {numbers[again[0]]} begins a second time. Rows "
            "of one run must stand together: sort the file, or choose another column."
        )
    absent = sorted(set(runs.keep or ()) - set(numbers.tolist()))
    if absent:
        there = ", ".join(str(numbers[at]) for at in starts[:20])
        raise RecordingError(
            f"{source.file} has no run {absent[0]} in column {runs.column!r}: it has {there}. Mend "
            "keep in the map's [runs]."
        )
    return numbers


def without_gaps(
    columns: Mapping[str, Array],
    rows: Rows,
    policy: Literal["refuse", "drop"],
    source: Source,
) -> tuple[Rows, tuple[Note, ...]]:
    """The rows in which every column is a finite number; RecordingError unless others may go."""
    good = np.ones(rows.size, np.bool_)
    for name, values in columns.items():
        finite = np.isfinite(values[rows])
        if policy == "refuse" and not finite.all():
            at = int(rows[np.argmin(finite)])
            raise RecordingError(
                f"{source.at(at)}: {name} is {values[at]} ({(~finite).sum()} such rows in all), "
                "and must be a finite number. Mend the file, or let such rows go with "
                'nan = "drop" in the map.'
            )
        good &= finite
    gone = int((~good).sum())
    notes = (Note(gone, f"{gone} rows had a value that is no finite number, and were dropped"),)
    return rows[good], notes if gone else ()


def inside(t_s: Array, rows: Rows, window: Window) -> tuple[Rows, tuple[Note, ...]]:
    """The rows whose time is in the window; those without a time are left for others to judge."""
    low = -np.inf if window.from_s is None else window.from_s
    high = np.inf if window.to_s is None else window.to_s
    outside = (t_s[rows] < low) | (t_s[rows] > high)
    gone = int(outside.sum())
    return rows[~outside], (Note(gone, f"{gone} rows lie outside the window"),) if gone else ()


def timed(
    t_s: Array,
    rows: Rows,
    run: NDArray[np.int64],
    policy: Literal["refuse", "spread", "first"],
    source: Source,
) -> tuple[Timed, tuple[Note, ...]]:
    """The rows with times that rise within each run.

    A time that several rows share is refused, or by the map's leave

        spread  row j of n with the time T: T + j (T' - T) / n, T' the run's next time; at the
                run's end as far as the tick before
        first   only the first of them is kept

    Raises RecordingError for a time that falls, that is repeated or cannot be spread, or that is
    beyond LATEST_S.
    """
    times = t_s[rows]
    if times.size and np.abs(times).max() > LATEST_S:
        at = int(rows[np.argmax(np.abs(times))])
        raise RecordingError(
            f"{source.at(at)}: the time is {t_s[at]:g} s, more than {LATEST_S:g} s. Is the "
            "time's unit right (s, ms, us, ns)?"
        )
    same_run = np.diff(run[rows]) == 0
    steps = np.diff(times)
    falls = np.flatnonzero(same_run & (steps < 0))
    if falls.size:
        at, before = int(rows[falls[0] + 1]), int(rows[falls[0]])
        raise RecordingError(
            f"{source.at(at)}: the time falls from {t_s[before]:.9g} s to {t_s[at]:.9g} s "
            f"({falls.size} times in all). Sort the file, or split it into runs by a column: "
            "[runs] in the map."
        )
    repeated = np.flatnonzero(same_run & (steps == 0))
    if repeated.size == 0:
        return Timed(rows, times), ()
    if policy == "refuse":
        at = int(rows[repeated[0] + 1])
        raise RecordingError(
            f"{source.at(at)}: the time {t_s[at]:.9g} s is repeated ({repeated.size} rows in "
            'all). Say in the map what that means: repeated = "spread" where a coarse clock '
            'stamped rows that were sampled evenly, "first" where only the first row is new.'
        )
    first_of_tick = np.concatenate([[True], ~(same_run & (steps == 0))])
    if policy == "first":
        text = f"{repeated.size} rows repeated the time before them, and were dropped"
        kept = Timed(rows[first_of_tick], times[first_of_tick])
        return kept, (Note(int(repeated.size), text),)
    moved = _spread(times, run[rows], first_of_tick)
    stuck = np.flatnonzero(same_run & ~(np.diff(moved) > 0))
    if stuck.size:
        raise RecordingError(
            f"{source.at(int(rows[stuck[0] + 1]))}: {repeated.size} rows repeat a time and "
            f"cannot be spread: the tick at {times[stuck[0]]:.9g} s is too short for its rows, or "
            'the only one of its run. Give repeated = "first", or leave that run out.'
        )
    text = f"{repeated.size} rows repeated a time, and were spread evenly within its tick"
    return Timed(rows, moved), (Note(int(repeated.size), text),)


def _spread(times: Array, run: NDArray[np.int64], first_of_tick: NDArray[np.bool_]) -> Array:
    starts = np.flatnonzero(first_of_tick)
    counts = np.diff(np.append(starts, times.size))
    ticks, runs = times[starts], run[starts]
    lengths = np.zeros(ticks.size)
    followed = np.append(np.diff(runs) == 0, False)
    lengths[followed] = np.diff(ticks)[followed[:-1]]
    for last in np.flatnonzero(~followed):
        # a run of one tick has no other to learn from, so its rows cannot be spread
        before = last > 0 and runs[last - 1] == runs[last]
        lengths[last] = lengths[last - 1] if before else np.nan
    place_in_tick = np.arange(times.size) - np.repeat(starts, counts)
    # without the leading term, nan * 0 would spoil the only row of a lonely tick
    shift = np.where(place_in_tick == 0, 0.0, place_in_tick * np.repeat(lengths / counts, counts))
    moved: Array = times + shift
    return moved


def period_s(t_s: Array, run: NDArray[np.int64]) -> float:
    """The median step within the runs; NaN where there is none."""
    steps = np.diff(t_s)[np.diff(run) == 0]
    return float(np.median(steps)) if steps.size else float("nan")


def split_points(run: NDArray[np.int64]) -> NDArray[np.intp]:
    """Where runs begin, but for the first."""
    points: NDArray[np.intp] = np.flatnonzero(np.diff(run)) + 1
    return points
