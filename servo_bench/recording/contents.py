"""What the records of a file say, gathered: rows, events, metadata, and what could not be read."""

import json
from collections.abc import Iterable
from typing import Any

import numpy as np
from mcap.records import Channel, Metadata, Schema
from numpy.typing import NDArray

from servo_bench.errors import RecordingError
from servo_bench.recording.columns import Decoder, decoder, json_object
from servo_bench.recording.fast import FastRows
from servo_bench.recording.format import (
    CONFIG_TOPIC,
    EVENTS_TOPIC,
    FAST_TOPIC,
    MAX_KEPT_BYTES,
    MEASURED_TOPIC,
    MIB,
    SAMPLES_TOPIC,
)
from servo_bench.recording.measured import MeasuredColumns
from servo_bench.recording.recording import SAMPLE_DTYPE, Event
from servo_bench.recording.scan import End, Item, Messages, Skipped


class Contents:
    """Filled item by item from a scan.

    `rows` are SAMPLE_DTYPE in the file's order, shape (samples,); `fields` are those of them that
    the file has; `fast` are the several samples of a slot; `measured` are the columns of data from
    elsewhere; `config` is the JSON of the /config message, if there is one.
    """

    def __init__(self, items: Iterable[Item]) -> None:
        """Raises RecordingError for messages that are not what docs/recording-format.md says."""
        self.metadata: dict[str, dict[str, str]] = {}
        self.config: dict[str, Any] = {}
        self.events: list[Event] = []
        self.measured = MeasuredColumns()
        self.fast = FastRows()
        self.fields: frozenset[str] = frozenset()
        self.skipped: list[Skipped] = []
        self.end = End(0, whole=False, lost_bytes=0)
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._decoders: dict[int, Decoder] = {}
        self._parts: list[NDArray[np.void]] = []
        self._kept_bytes = 0
        for item in items:
            self._take(item)
        self.rows = np.concatenate([*self._parts, np.empty(0, SAMPLE_DTYPE)])
        self._parts.clear()

    @property
    def topics(self) -> list[str]:
        """The names of all channels."""
        return sorted({channel.topic for channel in self._channels.values()})

    @property
    def cut(self) -> bool:
        """Whether anything of the file is missing."""
        return bool(self.skipped) or not self.end.whole

    @property
    def lost_bytes(self) -> int:
        """How many bytes of the file could not be read."""
        return self.end.lost_bytes + sum(skipped.length for skipped in self.skipped)

    def _take(self, item: Item) -> None:
        match item:
            case Messages():
                self._take_messages(item)
            case Schema():
                self._schemas[item.id] = item
            case Channel():
                self._take_channel(item)
            case Metadata():
                self.metadata[item.name] = item.metadata
            case Skipped():
                self.skipped.append(item)
            case End():
                self.end = item
            case _:
                pass  # an attachment is nothing that a recording is made of

    def _take_channel(self, channel: Channel) -> None:
        self._channels[channel.id] = channel
        if channel.topic == SAMPLES_TOPIC and channel.id not in self._decoders:
            made = decoder(channel, self._schemas.get(channel.schema_id))
            self._decoders[channel.id] = made
            self.fields |= made.fields
        if channel.topic == MEASURED_TOPIC:
            self.measured.declare(channel, self._schemas.get(channel.schema_id))
        if channel.topic == FAST_TOPIC:
            self.fast.declare(channel, self._schemas.get(channel.schema_id))

    def _take_messages(self, messages: Messages) -> None:
        channel = self._channels.get(messages.channel_id)
        topic = channel.topic if channel else ""
        if topic not in (SAMPLES_TOPIC, FAST_TOPIC, MEASURED_TOPIC, EVENTS_TOPIC, CONFIG_TOPIC):
            return
        self._kept_bytes += messages.bodies.size
        if self._kept_bytes > MAX_KEPT_BYTES:
            raise RecordingError(
                f"its samples and events are more than {MAX_KEPT_BYTES / MIB:.0f} MiB; split it "
                "by time with a tool for MCAP files"
            )
        if topic == SAMPLES_TOPIC:
            rows, fields = self._decoders[messages.channel_id].rows(messages.bodies)
            self._parts.append(rows)
            self.fields |= fields
        elif topic == FAST_TOPIC:
            self.fast.take(messages.channel_id, messages.bodies)
        elif topic == MEASURED_TOPIC:
            self.measured.take(messages.channel_id, messages.bodies)
        else:
            self._take_json(topic, messages)

    def _take_json(self, topic: str, messages: Messages) -> None:
        for body in messages.bodies:
            message = json_object(body.tobytes())
            if topic == CONFIG_TOPIC:
                self.config = message
            else:
                self.events.append(_event(message))


def _event(message: dict[str, Any]) -> Event:
    match {"data": {}, **message}:
        case {"time_ns": int(time_ns), "kind": str(kind), "text": str(text), "data": dict(data)}:
            return Event(time_ns, kind, text, data)
    raise RecordingError(
        f"an event is {json.dumps(message)[:120]}; it must have time_ns (an integer), kind and "
        "text (strings), and may have data (an object)"
    )
