"""The several samples of a slot: `/fast_samples`, one message for each, beside the slot's own row.

A time base of its own: `asked_ns` and `device_time_us` are each sample's, `slot` and `part` say
which of which command. Part 0 is the sample at the command's SYNC, and the same as the slot's row.
"""

from typing import Any

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from servo_bench.errors import RecordingError
from servo_bench.recording import cdr
from servo_bench.recording.format import FAST_KINDS, FAST_TOPIC, MAX_JSON_BYTES
from servo_bench.recording.recording import FAST_DTYPE, columns_of


class FastRows:
    """Filled batch by batch; `columns` is what came, in the order of slot and part."""

    def __init__(self) -> None:
        """Nothing came yet."""
        self._layouts: dict[int, np.dtype[np.void]] = {}
        self._parts: list[NDArray[np.void]] = []

    def declare(self, channel: Channel, schema: Schema | None) -> None:
        """A channel on `/fast_samples`; RecordingError where it is not the bench's own."""
        encoding = schema.encoding if schema else ""
        if channel.message_encoding != "cdr" or schema is None or encoding != "ros2msg":
            raise RecordingError(
                f"its messages on {FAST_TOPIC} are {channel.message_encoding!r} with a schema in "
                f"{encoding!r}; cdr with ros2msg can be read"
            )
        layout = cdr.layout(schema.data[:MAX_JSON_BYTES].decode(errors="replace"))
        for name, kind in FAST_KINDS.items():
            if name not in (layout.names or ()) or layout[name] != np.dtype(kind):
                raise RecordingError(f"the schema on {FAST_TOPIC} has no {kind} {name}")
        self._layouts[channel.id] = layout

    def take(self, channel_id: int, bodies: NDArray[np.uint8]) -> None:
        """Messages of that channel, shape (count, bytes)."""
        found = cdr.rows_from(bodies, self._layouts[channel_id])
        rows = np.empty(len(found), FAST_DTYPE)
        for name in FAST_KINDS:
            rows[name] = found[name]
        self._parts.append(rows)

    def columns(self) -> dict[str, NDArray[Any]]:
        """FAST_FIELDS by name, shape (samples,); empty without a message. Doubles are dropped."""
        if not self._parts:
            return {}
        rows = np.concatenate(self._parts)
        rows = rows[np.lexsort((rows["part"], rows["slot"]))]
        again = (np.diff(rows["slot"], prepend=-1) == 0) & (np.diff(rows["part"], prepend=0) == 0)
        return columns_of(rows[~again])
