"""Samples as ROS 2 messages: the schema text, and CDR bytes to and from numpy rows.

CDR (OMG DDS-XTypes, "plain CDR", XCDR version 1) puts a four-byte encapsulation header before the
fields: 0, then 1 for little-endian or 0 for big-endian, then two bytes of options. Each field is
aligned to its own size, counted from the end of that header. Our own rows hold their eight-byte
fields first, so that row and message are the same bytes:

    00 01 00 00 | slot int64 | chip int64 | ... | encoder_latency_s float64 | phase uint32 | ...
"""

import re
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import RecordingError
from servo_bench.recording.recording import SAMPLE_FIELDS

SCHEMA_NAME = "servo_bench_msgs/msg/Sample"
FAST_SCHEMA_NAME = "servo_bench_msgs/msg/FastSample"
LITTLE_ENDIAN = bytes((0, 1, 0, 0))
HEADER_BYTES = len(LITTLE_ENDIAN)

_PRIMITIVES = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    **{
        f"{sign}int{bits}": f"{sign or 'i'}{bits // 8}"
        for sign in ("", "u")
        for bits in (8, 16, 32, 64)
    },
    "float32": "f4",
    "float64": "f8",
}
_TIMES = ("builtin_interfaces/Time", "builtin_interfaces/Duration")
_FIELD = re.compile(
    r"(?P<type>[\w/]+)(?:\[(?P<count>\d{1,4})\])?\s+(?P<name>[A-Za-z]\w*)(?:\s+.*)?"
)
_CONSTANT = re.compile(r"[\w/<=]+(?:\[[<=\d]*\])?\s+[A-Za-z]\w*\s*=.*")

_MEANINGS = {
    "slot": "which period, counted from 0",
    "chip": "place in its sequence, -1 outside",
    "asked_ns": "CLOCK_MONOTONIC at the ask, ns",
    "device_time_us": "the device's own sampling time, us; -2^63 where it did not come",
    "motor_position_counts": "raw, unwrapped; -2^63 where it did not come",
    "load_angle_counts": "raw, unwrapped; -2^63 where it did not come",
    "part": "which of the slot's samples, counted from 0, the command's own",
    "phase": "0 standstill, 1 lead-in, 2 identification, 3 validation",
    "statusword": "CiA 402 0x6041",
}


def schema_text(fields: Iterable[tuple[str, str]] = SAMPLE_FIELDS) -> str:
    """The `ros2msg` definition of a row with those fields, each a name and a type."""
    return "".join(
        f"{kind} {name}" + (f"  # {_MEANINGS[name]}" if name in _MEANINGS else "") + "\n"
        for name, kind in fields
    )


def payloads(rows: NDArray[np.void]) -> NDArray[np.uint8]:
    """Rows without padding, shape (n,), as CDR messages, shape (n, 4 + bytes of a row)."""
    packed = np.ascontiguousarray(rows)
    messages = np.empty((rows.size, HEADER_BYTES + rows.dtype.itemsize), np.uint8)
    messages[:, :HEADER_BYTES] = np.frombuffer(LITTLE_ENDIAN, np.uint8)
    messages[:, HEADER_BYTES:] = packed.view(np.uint8).reshape(rows.size, rows.dtype.itemsize)
    return messages


def layout(text: str) -> np.dtype[np.void]:
    """The fields of a `ros2msg` definition as a little-endian dtype with CDR's alignment.

    It ends before the first line whose size the definition does not fix (a string, a sequence, a
    nested message), because nothing behind that has a fixed place.
    """
    names: list[str] = []
    formats: list[str | tuple[str, tuple[int]]] = []
    offsets: list[int] = []
    end = 0
    for line in _lines(text):
        match = _FIELD.fullmatch(line)
        if match is None or match["name"] in names:
            break
        kind = _PRIMITIVES.get(match["type"])
        size = int(kind[1]) if kind else 4
        if kind is None and match["type"] not in _TIMES:
            break
        count = int(match["count"] or 1) * (1 if kind else 2)
        names.append(match["name"])
        formats.append(f"<{kind or 'u4'}" if count == 1 else (f"<{kind or 'u4'}", (count,)))
        offsets.append(-(-end // size) * size)
        end = offsets[-1] + count * size
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": end})


def _lines(text: str) -> list[str]:
    """The lines of the first definition that hold a field."""
    own = re.split(r"^={3,}\s*$", text, maxsplit=1, flags=re.MULTILINE)[0]
    lines = (line.split("#", 1)[0].strip() for line in own.splitlines())
    return [line for line in lines if line and not _CONSTANT.fullmatch(line)]


def rows_from(messages: NDArray[np.uint8], fields: np.dtype[np.void]) -> NDArray[np.void]:
    """CDR messages, shape (n, at least 4 + bytes of `fields`), as rows of `fields`, shape (n,).

    Raises RecordingError where the encapsulation is not plain CDR, or changes among messages.
    """
    if len(messages) == 0:
        return np.empty(0, fields)
    if messages.shape[1] < HEADER_BYTES + fields.itemsize:
        raise RecordingError(
            f"a message of {messages.shape[1]} bytes is shorter than its schema, which needs "
            f"{HEADER_BYTES + fields.itemsize}"
        )
    kinds = messages[:, :2]
    if (kinds != kinds[0]).any() or kinds[0, 0] != 0 or kinds[0, 1] > 1:
        raise RecordingError(
            f"its encapsulation is {kinds[0].tolist()}; plain CDR begins with 0 and then 1 "
            "(little-endian) or 0 (big-endian)"
        )
    order = fields if kinds[0, 1] == 1 else fields.newbyteorder(">")
    body = np.ascontiguousarray(messages[:, HEADER_BYTES : HEADER_BYTES + fields.itemsize])
    rows: NDArray[np.void] = body.view(order)[:, 0]
    return rows
