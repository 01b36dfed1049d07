"""Sample messages, whatever their encoding, as rows of SAMPLE_DTYPE.

A stranger's values may come in other types than ours: they are taken where nothing is lost (1.0
for slot 1), and refused where something would be (1.5 for a slot).
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from servo_bench.errors import RecordingError
from servo_bench.recording import cdr
from servo_bench.recording.format import DOCUMENT, MAX_JSON_BYTES, SAMPLE_KINDS
from servo_bench.recording.recording import MISSING, SAMPLE_DTYPE

Rows = NDArray[np.void]

NULL_IS_ZERO = frozenset({"statusword"})
"""A value that did not come, where the field has no other word for that."""


@dataclass(frozen=True, slots=True)
class Decoder:
    """How one channel's messages become rows: `rows` takes bodies of shape (count, bytes).

    `fields` are the SAMPLE_FIELDS that its messages can hold, known before any came for CDR; for
    JSON they show in the messages, and `rows` says them beside the rows.
    """

    fields: frozenset[str]
    rows: Callable[[NDArray[np.uint8]], tuple[Rows, frozenset[str]]]


def decoder(channel: Channel, schema: Schema | None) -> Decoder:
    """The decoder for a channel. Raises RecordingError for an encoding that cannot be read."""
    if channel.message_encoding == "json":
        return Decoder(frozenset(), _json_rows)
    if channel.message_encoding == "cdr" and schema and schema.encoding == "ros2msg":
        return _cdr_decoder(schema.data)
    encoding = schema.encoding if schema else ""
    raise RecordingError(
        f"its messages are {channel.message_encoding!r} with a schema in {encoding!r}; json, or "
        f"cdr with ros2msg, can be read (see {DOCUMENT})"
    )


def _cdr_decoder(text: bytes) -> Decoder:
    fields = cdr.layout(text[:MAX_JSON_BYTES].decode(errors="replace"))
    names = frozenset(fields.names or ()) & SAMPLE_KINDS.keys()
    ours = fields == SAMPLE_DTYPE

    def rows(bodies: NDArray[np.uint8]) -> tuple[Rows, frozenset[str]]:
        if not names:
            return blank(len(bodies)), names
        found = cdr.rows_from(bodies, fields)
        if ours and found.dtype == SAMPLE_DTYPE:
            return found, names
        return from_columns({name: found[name] for name in names}, len(bodies)), names

    return Decoder(names, rows)


def _json_rows(bodies: NDArray[np.uint8]) -> tuple[Rows, frozenset[str]]:
    messages = [_known(json_object(body.tobytes())) for body in bodies]
    names = frozenset().union(*messages) & SAMPLE_KINDS.keys()
    columns = {name: _column(name, [message.get(name) for message in messages]) for name in names}
    return from_columns(columns, len(bodies)), names


def json_object(text: bytes) -> dict[str, Any]:
    """The object in a JSON message; RecordingError where it is none."""
    if len(text) > MAX_JSON_BYTES:
        raise RecordingError(
            f"a JSON message of {len(text)} bytes is above the {MAX_JSON_BYTES} that are allowed"
        )
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"a message is not JSON ({error})") from error
    if not isinstance(value, dict):
        raise RecordingError(f"a message is a JSON {type(value).__name__} and not an object")
    return value


def _known(message: dict[str, Any]) -> dict[str, int | float | None]:
    """The fields of a sample that are ours; RecordingError where one is no number."""
    known = {name: value for name, value in message.items() if name in SAMPLE_KINDS}
    for name, value in known.items():
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise RecordingError(f"{name} is {str(value)[:40]!r} in a message, and not a number")
    return known


def _column(name: str, values: list[int | float | None]) -> NDArray[Any]:
    """JSON numbers as int64 where the field is and all of them are, else as float64."""
    try:
        if SAMPLE_KINDS[name] == "int64" and not any(isinstance(v, float) for v in values):
            return np.array([MISSING if v is None else v for v in values], np.int64)
        return np.array([np.nan if v is None else v for v in values], np.float64)
    except OverflowError as error:
        raise RecordingError(f"{name} does not fit into 64 bits in a message") from error


def blank(count: int) -> Rows:
    """Rows in which nothing has come: NaN, MISSING, and 0 for phase and statusword."""
    rows = np.zeros(count, SAMPLE_DTYPE)
    for name, kind in SAMPLE_KINDS.items():
        if kind != "uint32":
            rows[name] = np.nan if kind == "float64" else MISSING
    return rows


def from_columns(columns: dict[str, NDArray[Any]], count: int) -> Rows:
    """Rows from arrays of shape (count,) by field; RecordingError where a value does not fit."""
    rows = blank(count)
    for name, values in columns.items():
        if values.ndim != 1:
            raise RecordingError(f"{name} is an array in each message, and not one number")
        rows[name] = _fitted(name, values)
    return rows


def _fitted(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """`values` in the field's own type; NaN becomes MISSING where that type is int64."""
    kind = np.dtype(SAMPLE_KINDS[name])
    if kind.kind == "f":
        with np.errstate(invalid="ignore"):  # a signalling NaN is a NaN
            return values.astype(kind)
    gone = np.zeros(values.shape, bool)
    if values.dtype.kind == "f":
        gone = np.isnan(values) if kind.kind == "i" or name in NULL_IS_ZERO else gone
        values = np.where(gone, 0, values)
        whole = values == np.trunc(values)
        # 2^63 and 2^32 are floats, the largest int64 is not: compare with what is exact
        good = (
            whole
            & (values >= np.iinfo(kind).min)
            & (values < 2.0 ** (kind.itemsize * 8 - (kind.kind == "i")))
        )
    else:
        good = _inside(values, kind)
    if not good.all():
        raise RecordingError(
            f"{name} is {values[np.argmin(good)]} in a message, and must be a whole number in "
            f"{kind}"
        )
    fitted = values.astype(kind)
    if gone.any() and kind.kind == "i":
        fitted[gone] = MISSING
    return fitted


def _inside(values: NDArray[Any], kind: np.dtype[Any]) -> NDArray[np.bool_]:
    """Which integers fit into `kind`, compared without changing their type."""
    low, high = np.iinfo(kind).min, np.iinfo(kind).max
    own = np.iinfo(values.dtype)
    above: NDArray[np.bool_] = values >= max(low, own.min)
    return above & (values <= min(high, own.max))
