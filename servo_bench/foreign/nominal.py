"""The nominal plant of a map, with the values that the data file holds put in."""

from pathlib import Path
from typing import Any

from servo_bench.errors import ConfigError
from servo_bench.foreign.maps import LoadedMap
from servo_bench.foreign.tables import Table
from servo_bench.recording.plant import ForeignPlant, plant_from_table


def plant_of(table: Table, loaded: LoadedMap, path: Path) -> ForeignPlant | None:
    """The map's plant; `{ from = "path", scale = ... }` in it is a number that the file holds."""
    if loaded.map.plant is None:
        return None
    where = f"[plant] of {loaded.path}"
    named = {"name": loaded.map.name, **_resolved(loaded.map.plant, table, path, where)}
    return plant_from_table(named, where)


def _resolved(values: dict[str, Any], table: Table, path: Path, where: str) -> dict[str, Any]:
    resolved: dict[str, Any] = {}
    for key, value in values.items():
        match value:
            case {"from": str(source), **rest} if set(rest) <= {"scale"}:
                number = table.scalar(source)
                scale = rest.get("scale", 1.0)
                if number is None or not isinstance(scale, int | float):
                    raise ConfigError(
                        f"{where}: {key} comes from {source!r} in {path}, times {scale!r}, and "
                        "there is no such number. Mend the path, or write the value itself."
                    )
                resolved[key] = number * scale
            case dict():
                resolved[key] = _resolved(value, table, path, where)
            case _:
                resolved[key] = value
    return resolved
