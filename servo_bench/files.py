"""Finding and reading the TOML files that people write.

A name is looked for where it says (relative to the working folder, or to the file that mentions
it) and then among the rigs and experiments that ship with the bench, so that
`servo-bench run experiments/paper.toml` works in an empty folder.
"""

import tomllib
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

import sim_rig
from servo_bench.errors import ConfigError
from servo_bench.units import spellings, to_si

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
        if not isinstance(data, dict):
            return data
        converted = to_si(data)
        for name, value in converted.items():
            field = cls.model_fields.get(name)
            if field is not None and isinstance(value, str | bool) and _is_number(field.annotation):
                raise ValueError(f"{name} = {value!r}: give a number, without quotation marks")
        return converted


def _is_number(annotation: Any) -> bool:
    """Whether a field takes numbers and nothing else; None aside."""
    allowed = set(get_args(annotation) or (annotation,)) - {type(None)}
    return bool(allowed) and allowed <= {int, float}


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
        missing = [_key(item["loc"], table)[0] for item in items if item["type"] == "missing"]
        lines = []
        for item in items:
            key, written = _key(item["loc"], table, of_a_table=item["type"] == "value_error")
            got = item["input"] if written is None else written
            lines.append(
                f"  {key}: {item['msg']}"
                + (f", got {got!r}" if item["type"] not in ("missing", "value_error") else "")
                + (_meant(key, missing) if item["type"] == EXTRA else "")
            )
        raise ConfigError(f"{source}: mend these keys:\n" + "\n".join(lines)) from error


def _meant(key: str, missing: list[str]) -> str:
    """The missing key that one too many was probably meant to be, in words; in the reader's unit
    where that is nearer to what was written."""
    near = get_close_matches(key, [name for one in missing for name in spellings(one)], n=1)
    return f". Is {near[0]} meant?" if near else ""


def _key(place: tuple[int | str, ...], table: Any, *, of_a_table: bool = False) -> tuple[str, Any]:
    """The dotted key at a validator's `place`, without the names of union members it has tried, as
    the reader has written it; and where that was in another unit, what was written. What is said
    `of_a_table` as a whole may end in such a name."""
    parts: list[str] = []
    converted = False
    for depth, part in enumerate(place):
        name = part
        if isinstance(table, dict) and part not in table:
            name = next((n for n in spellings(str(part)) if n in table), part)
            if name == part and (of_a_table or depth < len(place) - 1):
                continue
            converted = converted or name != part
        parts.append(str(name))
        table = _at(table, name)
    return ".".join(parts) or "(file)", table if converted else None


def _at(table: Any, key: int | str) -> Any:
    if isinstance(table, dict):
        return table.get(key)
    inside = isinstance(table, list) and isinstance(key, int) and key < len(table)
    return table[key] if inside else None
