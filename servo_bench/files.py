"""Finding and reading the TOML files that people write.

A name is looked for where it says (relative to the working folder, or to the file that mentions
it) and then among the rigs and experiments that ship with the bench, so that
`servo-bench run experiments/paper.toml` works in an empty folder.
"""

import tomllib
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

import sim_rig
from servo_bench.errors import ConfigError
from servo_bench.units import to_si

SHIPPED = (Path(__file__).parent / "library", Path(sim_rig.__file__).parent)
Model = TypeVar("Model", bound=BaseModel)
EXTRA = "extra_forbidden"
"""A validator's word for a key that nobody reads."""


class Value(BaseModel):
    """A frozen value that is written in TOML: unknown keys refused, readers' units accepted."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _accept_readers_units(cls, data: Any) -> Any:
        return to_si(data) if isinstance(data, dict) else data


def find(name: str | Path, beside: Path | None = None) -> Path:
    """The file called `name`, or ConfigError naming every place that was looked at."""
    places = [
        Path(name),
        *([beside / name] if beside else []),
        *(folder / name for folder in SHIPPED),
    ]
    for place in places:
        if _is_file(place):
            return place.resolve()
    looked = ", ".join(str(place.absolute()) for place in dict.fromkeys(places))
    raise ConfigError(f"there is no file {name}: looked for {looked}. Correct the path.")


def _is_file(place: Path) -> bool:
    try:
        return place.is_file()
    except (OSError, ValueError):  # longer than the system takes, or with a NUL in it
        return False


def read_toml(path: Path) -> dict[str, Any]:
    """The table in a TOML file; ConfigError with line and column where it is none."""
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} is not TOML: {error}. Mend that line.") from error
    except RecursionError as error:
        raise ConfigError(f"{path} is nested too deeply. Mend it.") from error
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}.") from error


def validated(model: type[Model], table: dict[str, Any], source: str) -> Model:
    """`table` as a `model`; ConfigError with one line for each key that does not fit."""
    try:
        return model.model_validate(table)
    except ValidationError as error:
        items = error.errors(include_url=False)
        missing = [_key(item["loc"], table) for item in items if item["type"] == "missing"]
        lines = [
            f"  {_key(item['loc'], table)}: {item['msg']}"
            + (f", got {item['input']!r}" if item["type"] != "missing" else "")
            + (_meant(_key(item["loc"], table), missing) if item["type"] == EXTRA else "")
            for item in items
        ]
        raise ConfigError(f"{source}: mend these keys:\n" + "\n".join(lines)) from error


def _meant(key: str, missing: list[str]) -> str:
    """The missing key that one too many was probably meant to be, in words."""
    near = get_close_matches(key, missing, n=1)
    return f". Is {near[0]} meant?" if near else ""


def _key(place: tuple[int | str, ...], table: Any) -> str:
    """The dotted key at a validator's `place`, without the names of union members it has tried."""
    parts: list[str] = []
    for depth, part in enumerate(place):
        last = depth == len(place) - 1
        if isinstance(table, dict) and part not in table and not last:
            continue
        parts.append(str(part))
        if isinstance(table, dict):
            table = table.get(part)
    return ".".join(parts) or "(file)"
