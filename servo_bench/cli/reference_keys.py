"""The keys of a file in Markdown: for each table of it key, type, default, and meaning.

Types, bounds, and defaults are those of the JSON schema that pydantic makes of the model which
reads the file; words are the model's docstring and the docstrings below its fields.
"""

import ast
import inspect
import textwrap
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel

from drivers.canopen.profile import DriveProfile as CanopenProfile
from drivers.counter.profile import CounterProfile
from drivers.modbus.profile import DriveProfile as RegisterMap
from servo_bench.check.plan import Plan
from servo_bench.cli.reference_commands import cell
from servo_bench.daemon.config import BenchConfig
from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.excitation.experiment import Experiment
from servo_bench.rig import RigConfig

Schema = Mapping[str, Any]


class File(NamedTuple):
    """A kind of file, and the model that reads or writes it."""

    title: str
    model: type[BaseModel]
    toml: bool = True


FILES = (
    File("Rig: `rig.toml`", RigConfig),
    File("Experiment: `experiment.toml`", Experiment),
    File("Daemon: `bench.toml`", BenchConfig),
    File("Acceptance plan: `plan.toml`", Plan),
    File("Drive profile on CANopen", CanopenProfile),
    File("Register map on Modbus", RegisterMap),
    File("Framing of a serial counter", CounterProfile),
    File("Verdict: JSON of `servo-bench diagnose`", Verdict, toml=False),
)

_BOUNDS = (
    ("minimum", "at least {}"),
    ("exclusiveMinimum", "above {}"),
    ("maximum", "at most {}"),
    ("exclusiveMaximum", "below {}"),
    ("minLength", "{} characters at least"),
    ("minItems", "{} or more"),
)
_TYPES = {
    "string": "text",
    "number": "number",
    "integer": "whole number",
    "boolean": "true or false",
    "null": "null",
}


class Table(NamedTuple):
    """A table of a file: every place where it may stand, and its schema. The file's own is ""."""

    places: list[str]
    schema: Schema


def key_sections(file: File) -> Iterator[str]:
    """The lines of the page for one kind of file, a section for each of its tables."""
    said = attribute_docstrings(file.model)
    for name, table in tables(file).items():
        if table.places != [""]:
            places = ", ".join(_heading(p) if file.toml else f"`{p}`" for p in table.places)
            yield from (f"### {places}: {name}", "")
        yield from (table.schema.get("description", ""), "")
        yield from _rows(table.schema, {k: v for (kind, k), v in said.items() if kind == name})
        yield ""


def _rows(schema: Schema, said: Mapping[str, str]) -> Iterator[str]:
    """The keys of a table with their meanings; those of a key that has none are empty."""
    yield from ("| key | type | default | meaning |", "|---|---|---|---|")
    for key, value in schema.get("properties", {}).items():
        default = "needed" if key in schema.get("required", ()) else _default(value)
        yield f"| `{key}` | {cell(_type(value))} | {default} | {cell(said.get(key, ''))} |"


def _heading(place: str) -> str:
    """A table's place as its TOML heading: `[[answers]]` for one of several."""
    return f"`[[{place[:-2]}]]`" if place.endswith("[]") else f"`[{place}]`"


def tables(file: File) -> dict[str, Table]:
    """Every table that a file can have, by the name of its model; the file itself comes first."""
    whole = file.model.model_json_schema()
    found: dict[str, Table] = {}
    _gather("", whole, whole.get("$defs", {}), found)
    return found


def _gather(
    place: str, schema: Schema, definitions: Mapping[str, Schema], found: dict[str, Table]
) -> None:
    table = found.setdefault(schema["title"], Table([], schema))
    if place in table.places:
        return
    table.places.append(place)
    for key, value in schema.get("properties", {}).items():
        for inner, name in _references(value, f"{place}.{key}" if place else key):
            _gather(inner, definitions[name], definitions, found)


def _references(schema: Schema, place: str) -> Iterator[tuple[str, str]]:
    """The models that a value may be, each with the place where its keys stand."""
    if "$ref" in schema:
        yield place, _name(schema)
    for one in _choices(schema):
        yield from _references(one, place)
    if isinstance(schema.get("additionalProperties"), dict):
        yield from _references(schema["additionalProperties"], f"{place}.NAME")
    if isinstance(schema.get("items"), dict):
        yield from _references(schema["items"], f"{place}[]")


def _type(schema: Schema) -> str:
    if "$ref" in schema:
        return f"table ({_name(schema)})"
    if choices := _choices(schema):
        hidden = {"type": "null"} if "default" in schema else None  # "none" is then the default
        return " or ".join(dict.fromkeys(_type(one) for one in choices if one != hidden))
    if "const" in schema:
        return f"`{_literal(schema['const'])}`"
    if "enum" in schema:
        return ", ".join(f"`{_literal(value)}`" for value in schema["enum"])
    if schema.get("type") == "array":
        return _list(schema)
    if schema.get("type") == "object":
        inner = schema.get("additionalProperties")
        name = f"by name: {_type(inner)}" if isinstance(inner, dict) else "table"
    elif schema.get("format") == "object":
        name = 'object ("0x6041", "0x60E4:2")'
    else:
        name = _TYPES.get(schema.get("type", ""), "anything")
    return ", ".join([name, *_bounds(schema)])


def _list(schema: Schema) -> str:
    if "prefixItems" in schema:
        inner = ", ".join(_type(one) for one in schema["prefixItems"])
        return f"list of {len(schema['prefixItems'])}: {inner}"
    return ", ".join([f"list of {_type(schema.get('items', {}))}", *_bounds(schema)])


def _bounds(schema: Schema) -> list[str]:
    return [words.format(_literal(schema[key])) for key, words in _BOUNDS if key in schema]


def _choices(schema: Schema) -> list[Schema]:
    return [one for word in ("anyOf", "oneOf", "allOf") for one in schema.get(word, ())]


def _name(schema: Schema) -> str:
    return str(schema["$ref"]).rsplit("/", 1)[1]


def _default(schema: Schema) -> str:
    value = schema.get("default")
    if value is None:
        return "none"
    if schema.get("format") == "object":
        return f"`{_object(value)}`"
    if schema.get("items", {}).get("format") == "object":
        return f"`[{', '.join(_object(one) for one in value)}]`"
    return "its own" if isinstance(value, dict) else f"`{_literal(value)}`"


def _object(address: tuple[int, int]) -> str:
    """An object of CANopen as a profile writes it."""
    index, sub = address
    return f'"0x{index:04X}{f":{sub}" if sub else ""}"'


def _literal(value: Any) -> str:
    """A value as TOML and JSON write it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list):
        return f"[{', '.join(_literal(one) for one in value)}]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def attribute_docstrings(model: type[BaseModel]) -> dict[tuple[str, str], str]:
    """The texts below the fields of a model and of those inside it, by (class, field)."""
    return {
        (kind.__name__, kind.model_fields[field].alias or field): text
        for kind in _models(model, set())
        for base in reversed(kind.__mro__)
        if issubclass(base, BaseModel) and base is not BaseModel
        for field, text in _texts(base).items()
    }


def _models(kind: Any, seen: set[type[BaseModel]]) -> set[type[BaseModel]]:
    if isinstance(kind, type) and issubclass(kind, BaseModel) and kind not in seen:
        seen.add(kind)
        for field in kind.model_fields.values():
            _models(field.annotation, seen)
    for inner in get_args(kind):
        _models(inner, seen)
    return seen


@cache
def _texts(kind: type[BaseModel]) -> dict[str, str]:
    definition = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    body = definition.body if isinstance(definition, ast.ClassDef) else []
    return {
        field.target.id: inspect.cleandoc(text.value.value)
        for field, text in pairwise(body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }
