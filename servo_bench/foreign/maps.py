"""A map: which column of a foreign file is what, in which unit, and what the plant nominally is.

docs/import.md describes every key, with an example.
"""

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, NonNegativeInt, PositiveFloat

from servo_bench.errors import ConfigError
from servo_bench.files import Value, find, read_toml, validated
from servo_bench.foreign.quantities import INTEGERS, ROLES, Unit, role_of, unit_of

Format = Literal["csv", "json", "mat", "npz", "parquet"]
Column = int | str
NAME = re.compile(r"[a-z][a-z0-9_]{0,22}")
"""With the longest suffix (_rad_s) no more than the 31 characters that a MAT file allows."""
RUN = "run"


class FileLayout(Value):
    """`[file]`: how the file is laid out.

    `table` is the dotted path to the columns or records; `columns`, where it is given, are all of
    the file's columns, so that a map is not used for a file that only looks alike.
    """

    format: Format | None = None
    table: str = ""
    columns: tuple[str, ...] | None = None
    delimiter: str = Field(default="", max_length=10)
    comment: str = Field(default="#", min_length=1)
    header: bool = True
    skip_lines: NonNegativeInt = 0
    skip_rows: NonNegativeInt = 0
    decimal: Literal[".", ","] = "."
    encoding: str = "utf-8"


class ChannelMap(Value):
    """One `[[channel]]`: sign (scale raw + offset) times, in `unit`."""

    role: str
    column: Column | None = None
    value: float | None = None
    unit: str = "1"
    name: str | None = None
    counts_per_rev: PositiveFloat | None = None
    scale: float = 1.0
    offset: float = 0.0
    sign: Literal[1, -1] = 1
    times: Column | None = None
    integer_bits: Literal[8, 16, 32] | None = None
    unwrap: bool = False
    optional: bool = False


class RunsMap(Value):
    """`[runs]`: rows with one value in `column` are one run; `keep` names those that are kept."""

    column: Column
    keep: tuple[int, ...] | None = Field(default=None, min_length=1)


class Window(Value):
    """`[window]`: rows whose time is outside are left out; both ends are kept."""

    from_s: float | None = None
    to_s: float | None = None


class Map(Value):
    """A map file, whole. `plant` is resolved with the data file, which may hold its values."""

    name: str
    source: str = ""
    file: FileLayout = FileLayout()
    period_s: PositiveFloat | None = None
    repeated: Literal["refuse", "spread", "first"] = "refuse"
    nan: Literal["refuse", "drop"] = "refuse"
    runs: RunsMap | None = None
    window: Window = Window()
    channel: tuple[ChannelMap, ...] = Field(min_length=1)
    plant: dict[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class LoadedMap:
    """A map, the text that it was read from, and the file's path."""

    map: Map
    text: str
    path: Path


@dataclass(frozen=True, slots=True)
class Wanted:
    """One channel as the map wants it: its name in the recording, unit, and whether it is whole."""

    name: str
    entry: ChannelMap
    unit: Unit
    integer: bool
    where: str


def load_map(name: str | Path) -> LoadedMap:
    """Read a map; shipped ones are found by name (`maps/laas_cogging.toml`).

    Raises ConfigError where it is missing, is no map, or asks for something that makes no sense.
    """
    path = find(name)
    table = read_toml(path)
    loaded = LoadedMap(validated(Map, table, str(path)), path.read_text(encoding="utf-8"), path)
    wanted(loaded)
    return loaded


def wanted(loaded: LoadedMap) -> tuple[Wanted, ...]:
    """Every channel that the map asks for; ConfigError where one does not fit."""
    channels = tuple(
        _wanted(entry, f"{loaded.path}, channel {number} ({entry.role})")
        for number, entry in enumerate(loaded.map.channel, start=1)
    )
    twice = [name for name, count in Counter(one.name for one in channels).items() if count > 1]
    if twice:
        raise ConfigError(
            f"{loaded.path}: two channels would be {twice[0]}. Leave one out, or give one of them "
            "a name of its own (name = ...)."
        )
    names = {one.name for one in channels}
    if ("t_s" in names) == (loaded.map.period_s is not None):
        got = "both" if "t_s" in names else "neither"
        raise ConfigError(
            f"{loaded.path}: time comes from a channel with the role time or from period_s, and "
            f"{got} is there. Give one of them."
        )
    if names == {"t_s"}:
        raise ConfigError(f"{loaded.path}: there is no channel but time. Add what was measured.")
    return channels


def _wanted(entry: ChannelMap, where: str) -> Wanted:
    role = role_of(entry.role, where)
    unit = unit_of(entry.role, entry.unit, entry.counts_per_rev, where)
    if (entry.column is None) == (entry.value is None):
        raise ConfigError(
            f"{where}: column is {entry.column!r} and value is {entry.value!r}. Give one of them: "
            "a column of the file, or one value for all rows."
        )
    if entry.optional and entry.role == "time":
        raise ConfigError(
            f"{where}: a time cannot be optional. Leave optional out; a file without a time has a "
            "period_s."
        )
    if entry.unwrap and role.quantity != "angle":
        raise ConfigError(
            f"{where}: unwrap undoes the wrap of an angle at one revolution, and this is a "
            f"{role.quantity}. Leave it out."
        )
    return Wanted(_channel_name(entry, where), entry, unit, role.quantity == INTEGERS, where)


def _channel_name(entry: ChannelMap, where: str) -> str:
    role = role_of(entry.role, where)
    if entry.name is None and not role.base:
        raise ConfigError(
            f"{where}: a {entry.role} has no name of its own. Give it one: name = ..."
        )
    if entry.name is None:
        return role.base + role.suffix
    if not NAME.fullmatch(entry.name) or entry.role == "time" or entry.name == RUN:
        raise ConfigError(
            f"{where}: its name is {entry.name!r}. Give up to 23 small letters, digits and "
            f"underscores, a letter first; {RUN} and the name of time are taken."
        )
    name = entry.name + role.suffix
    if name in {other.base + other.suffix for other in ROLES.values()}:
        raise ConfigError(
            f"{where}: its name would be {name}, which is another role's. Give it another name."
        )
    return name
