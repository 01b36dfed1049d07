"""A foreign file and its map become a Recording.

    columns -> runs kept -> window -> gaps -> times -> units -> channels

What the file says is kept: irregular times stay as they are, nothing is filtered or resampled, and
whatever the map lets happen to rows or times is told in the recording's events.
"""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import ConfigError, RecordingError
from servo_bench.foreign import rows
from servo_bench.foreign.maps import RUN, ChannelMap, Column, LoadedMap, Wanted, wanted
from servo_bench.foreign.nominal import plant_of
from servo_bench.foreign.source import read_bytes, read_table
from servo_bench.foreign.tables import Array, Table
from servo_bench.recording.provenance import provenance
from servo_bench.recording.recording import Event, Recording

LARGEST = 1e12
"""No angle, current, voltage ... of a motor is larger, in SI."""
FEWEST_ROWS = 2


def read_foreign(path: str | Path, loaded: LoadedMap) -> Recording:
    """The recording that the file at `path` is by that map.

    Channels: `t_s`, those of the map (float64 in SI, flags int64), and `run` (int64) where the map
    splits the file. `period_s` is the median step. `plant` is the map's; `provenance` has
    `source_file`, `source_sha256`, `map_file` and `map` (its text) beside this process's facts.

    Raises ConfigError where the map asks for what the file does not have, RecordingError where
    the file cannot be read or its numbers cannot be used.
    """
    name = Path(path)
    data = read_bytes(name)
    table = read_table(name, data, loaded)
    channels = wanted(loaded)
    columns, absent = _columns(table, channels, name)
    run = _runs(table, loaded, name, _height(columns, table, name))
    kept, t_s, notes = _kept(columns, run, loaded, rows.Source(str(name), table.place))
    values = {
        one.name: _finished(one, columns[one.name][kept], run[kept], name)
        for one in channels
        if one.name in columns and one.name != "t_s"
    }
    if loaded.map.runs is not None:
        values[RUN] = run[kept]
    notes = [*notes, *(rows.Note(0, f"there is no column for {one.name}") for one in absent)]
    return Recording(
        channels={"t_s": t_s, **values},
        period_s=loaded.map.period_s or rows.period_s(t_s, run[kept]),
        experiment=None,
        rig=None,
        provenance=_provenance(name, data, loaded),
        events=tuple(
            Event(time_ns=0, kind="import", text=note.text, data={"rows": note.count})
            for note in notes
        ),
        plant=plant_of(table, loaded, name),
    )


def _columns(
    table: Table, channels: tuple[Wanted, ...], path: Path
) -> tuple[dict[str, Array], list[Wanted]]:
    """Raw numbers by channel, in the map's unit, and the optional ones that the file lacks."""
    columns: dict[str, Array] = {}
    absent: list[Wanted] = []
    for one in channels:
        entry = one.entry
        asked = [column for column in (entry.column, entry.times) if column is not None]
        missing = [column for column in asked if not table.has(column)]
        if missing and entry.optional:
            absent.append(one)
        elif missing:
            raise _missing(table, missing[0], path, one.where)
        elif entry.column is not None:
            columns[one.name] = _raw(table, entry, entry.column, path)
    if not columns:
        raise ConfigError(f"{path} has none of the map's columns. Give the map of this file.")
    height = len(next(iter(columns.values())))
    for one in channels:
        if one.entry.value is not None and one not in absent:
            constant = np.full(height, one.entry.value)
            columns[one.name] = _told(table, one.entry, constant, path)
    return columns, absent


def _missing(table: Table, column: Column, path: Path, where: str) -> ConfigError:
    there = ", ".join(repr(name) for name in table.names[:40]) or "none"
    return ConfigError(
        f"{where}: {path} has no column {column!r}, or two of that name. It has {there}. Mend the "
        "column in the map (a name, or a number counted from 0), or set optional = true."
    )


def _raw(table: Table, entry: ChannelMap, column: Column, path: Path) -> Array:
    values = table.column(column)
    if entry.integer_bits is not None:
        values = _signed(values, entry.integer_bits)
    return _told(table, entry, values, path)


def _told(table: Table, entry: ChannelMap, values: Array, path: Path) -> Array:
    """Numbers as the map scales them."""
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is found as not finite
        values = entry.sign * (entry.scale * values + entry.offset)
        if entry.times is not None:
            factor = table.column(entry.times)
            _check_alike(factor, values, entry.times, path)
            values = values * factor
    return values


def _signed(values: Array, bits: int) -> Array:
    """A two's complement number that was read as an unsigned one."""
    half = 2.0 ** (bits - 1)
    return np.where((values >= half) & (values < 2.0 * half), values - 2.0 * half, values)


def _height(columns: Mapping[str, Array], table: Table, path: Path) -> int:
    first = next(iter(columns.values()))
    for name, values in columns.items():
        _check_alike(values, first, name, path)
    if len(first) < FEWEST_ROWS:
        raise RecordingError(
            f"{path} is empty: it has {len(first)} rows under {', '.join(table.names[:20])}. Give "
            f"a file with at least {FEWEST_ROWS}."
        )
    return len(first)


def _check_alike(values: Array, others: Array, name: Column, path: Path) -> None:
    if len(values) != len(others):
        raise RecordingError(
            f"{path}: {name} has {len(values)} rows, and another column {len(others)}. Columns "
            "must be alike in length: name the columns of one recording."
        )


def _runs(table: Table, loaded: LoadedMap, path: Path, height: int) -> NDArray[np.int64]:
    runs = loaded.map.runs
    if runs is None:
        return np.zeros(height, np.int64)
    if not table.has(runs.column):
        raise _missing(table, runs.column, path, f"{loaded.path}, [runs]")
    values = table.column(runs.column)
    if len(values) != height:
        raise RecordingError(
            f"{path}: {runs.column} has {len(values)} rows, and the channels have {height}. Name a "
            "column that says the run of every row."
        )
    return rows.run_numbers(values, runs, rows.Source(str(path), table.place))


def _kept(
    columns: Mapping[str, Array],
    run: NDArray[np.int64],
    loaded: LoadedMap,
    source: rows.Source,
) -> tuple[rows.Rows, Array, list[rows.Note]]:
    """The rows that are kept, their times in seconds, and what was done."""
    plan = loaded.map
    kept = np.arange(run.size)
    notes: list[rows.Note] = []
    if plan.runs is not None and plan.runs.keep is not None:
        kept = np.flatnonzero(np.isin(run, plan.runs.keep))
        left = run.size - kept.size
        notes += [rows.Note(left, f"{left} rows belong to runs that the map leaves out")]
    t_s = _times(columns, run, loaded)
    kept, more = rows.inside(t_s, kept, plan.window)
    notes += more
    finite = {name: values for name, values in columns.items() if name != "t_s"} | {"time": t_s}
    kept, more = rows.without_gaps(finite, kept, plan.nan, source)
    notes += more
    found, more = rows.timed(t_s, kept, run, plan.repeated, source)
    notes += more
    longest = np.unique(run[found.rows], return_counts=True)[1].max(initial=0)
    if longest < FEWEST_ROWS:
        raise RecordingError(
            f"{source.file}: {found.rows.size} of {run.size} rows are left, {longest} in the "
            f"longest run, and at least {FEWEST_ROWS} in one are needed. Mend window, keep, nan or "
            "repeated in the map."
        )
    return found.rows, found.t_s, notes


def _times(columns: Mapping[str, Array], run: NDArray[np.int64], loaded: LoadedMap) -> Array:
    """The file's own times, or row by row from each run's start with the map's period."""
    if loaded.map.period_s is not None:
        starts = np.append(0, rows.split_points(run))
        counts = np.diff(np.append(starts, run.size))
        within = np.arange(run.size) - np.repeat(starts, counts)
        times: Array = within * loaded.map.period_s
        return times
    (time,) = (one for one in wanted(loaded) if one.name == "t_s")
    with np.errstate(over="ignore", invalid="ignore"):
        return columns["t_s"] * time.unit.factor


def _finished(one: Wanted, values: Array, run: NDArray[np.int64], path: Path) -> NDArray[Any]:
    """The channel as it is recorded: unwrapped run by run, SI, whole where it must be."""
    with np.errstate(over="ignore"):
        values = values * one.unit.factor + one.unit.shift
    large = np.abs(values) > LARGEST
    if large.any():
        raise RecordingError(
            f"{path}: {one.name} is {values[np.argmax(large)]:g} ({large.sum()} such rows), more "
            f"than {LARGEST:g}. Are unit, scale and offset of {one.where} right?"
        )
    if one.entry.unwrap:
        parts = np.split(values, rows.split_points(run))
        values = np.concatenate([np.unwrap(part) for part in parts])
    if not one.integer:
        return values
    whole = values == np.trunc(values)
    if not whole.all():
        raise RecordingError(
            f"{path}: {one.name} is {values[np.argmin(whole)]:g}, and a {one.entry.role} is a "
            f"whole number. Is {one.where} the right column?"
        )
    return values.astype(np.int64)


def _provenance(path: Path, data: bytes, loaded: LoadedMap) -> dict[str, str]:
    return {
        **provenance(),
        "source_file": path.name,
        "source_sha256": hashlib.sha256(data).hexdigest(),
        "source": loaded.map.source,
        "map_file": loaded.path.name,
        "map": loaded.text,
    }
