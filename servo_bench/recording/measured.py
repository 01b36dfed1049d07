"""Recordings from elsewhere: one typed channel, `/measured`, whose schema is what was measured.

Every field is one number per message: `t_s`, and any others under the names that a recording gives
them. Numbers with a fraction become float64, whole ones int64.
"""

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from servo_bench.errors import RecordingError
from servo_bench.recording import cdr
from servo_bench.recording.format import MAX_JSON_BYTES, MEASURED_TOPIC

Column = NDArray[np.float64] | NDArray[np.int64]
TIME = "t_s"


class MeasuredColumns:
    """Filled channel by channel and batch by batch; `columns` is what came.

    Nothing is judged before `columns` is asked for: in the file of a run `/measured` is another
    program's channel, and is left alone.
    """

    def __init__(self) -> None:
        """Nothing came yet."""
        self._channels: dict[int, tuple[Channel, Schema | None]] = {}
        self._parts: list[tuple[int, NDArray[np.uint8]]] = []

    def declare(self, channel: Channel, schema: Schema | None) -> None:
        """A channel on `/measured`."""
        self._channels[channel.id] = (channel, schema)

    def take(self, channel_id: int, bodies: NDArray[np.uint8]) -> None:
        """Messages of that channel, shape (count, bytes)."""
        self._parts.append((channel_id, bodies.copy()))  # not a view of a whole chunk

    def columns(self) -> dict[str, Column]:
        """The channels by name, shape (rows,), in the schema's order.

        Raises RecordingError without messages or where they cannot be read, and where `t_s` is
        missing, alone, or not finite.
        """
        if not self._parts:
            raise RecordingError(f"there is no message on {MEASURED_TOPIC}")
        layouts = {number: _layout(*one) for number, one in self._channels.items()}
        if len({str(fields) for fields in layouts.values()}) > 1:
            raise RecordingError(f"two channels on {MEASURED_TOPIC} have different schemas")
        rows = np.concatenate(
            [
                cdr.rows_from(bodies, layouts[number]).astype(layouts[number])
                for number, bodies in self._parts
            ]
        )
        found = {
            name: _column(name, rows[name])
            for name in rows.dtype.names or ()
            if rows.dtype[name].ndim == 0
        }
        if TIME not in found or len(found) == 1:
            raise RecordingError(
                f"the messages on {MEASURED_TOPIC} have {', '.join(found) or 'arrays'}: {TIME} "
                "and at least one other number must be there"
            )
        found[TIME] = found[TIME].astype(np.float64)
        if not np.isfinite(found[TIME]).all():
            row = int(np.argmin(np.isfinite(found[TIME])))
            raise RecordingError(f"{TIME} is {found[TIME][row]} in message {row + 1}")
        return found


def _layout(channel: Channel, schema: Schema | None) -> np.dtype[np.void]:
    if channel.message_encoding != "cdr" or schema is None or schema.encoding != "ros2msg":
        raise RecordingError(
            f"its messages on {MEASURED_TOPIC} are {channel.message_encoding!r} with a schema in "
            f"{schema.encoding if schema else ''!r}; cdr with ros2msg can be read"
        )
    fields = cdr.layout(schema.data[:MAX_JSON_BYTES].decode(errors="replace"))
    if not fields.names:
        raise RecordingError(f"the schema on {MEASURED_TOPIC} begins with no number")
    return fields


def _column(name: str, values: NDArray[np.generic]) -> Column:
    if values.dtype.kind == "f":
        with np.errstate(invalid="ignore"):  # a signalling NaN is a NaN
            return values.astype(np.float64)
    if values.dtype.kind == "u" and (values > np.uint64(np.iinfo(np.int64).max)).any():
        raise RecordingError(f"{name} does not fit into int64 in a message")
    return values.astype(np.int64)
