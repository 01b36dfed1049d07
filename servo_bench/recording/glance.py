"""What a recording file says of itself, read from its ends and not from its samples.

A whole MCAP file ends with a summary: how many messages each channel has, where the metadata
stand, and which chunks hold events. Those few records are read. A file without a summary (cut,
or by another program) is walked from end to end.
"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Statistics
from mcap.summary import Summary

from servo_bench.errors import RecordingError
from servo_bench.recording.contents import Contents
from servo_bench.recording.format import (
    DOCUMENT,
    EVENTS_TOPIC,
    FORMAT_METADATA,
    MAX_CHUNK_BYTES,
    MEASURED_TOPIC,
    SAMPLES_TOPIC,
)
from servo_bench.recording.reader import contents_of, read_bytes
from servo_bench.recording.recording import Event
from servo_bench.recording.scan import MAGIC, RECORD_HEAD, End, Item, scan

_UNREADABLE = (McapError, struct.error, ValueError, OverflowError, EOFError, LookupError)


@dataclass(frozen=True, slots=True)
class Glance:
    """`samples` counts the rows of /samples or /measured; `whole`: nothing of the file is gone."""

    whole: bool
    samples: int
    metadata: Mapping[str, Mapping[str, str]]
    events: tuple[Event, ...]
    measured: bool


def glance(path: Path) -> Glance:
    """Look at a file. RecordingError where it cannot be read or holds nothing of a recording."""
    try:
        with path.open("rb") as file:
            found = _by_summary(file)
    except OSError as error:
        raise RecordingError(
            f"{path} cannot be read: {error.strerror}. Give the path of a recording."
        ) from error
    found = found or _by_walking(path)
    if not found.measured and not found.samples and FORMAT_METADATA not in found.metadata:
        raise RecordingError(
            f"{path} is an MCAP file and no recording of ours: it has neither {SAMPLES_TOPIC} nor "
            f"{MEASURED_TOPIC}. {DOCUMENT} says what a recording holds."
        )
    return found


def _by_summary(file: IO[bytes]) -> Glance | None:
    """None where the file has no summary that can be used."""
    try:
        summary = SeekingReader(file, record_size_limit=MAX_CHUNK_BYTES).get_summary()
        if summary is None or summary.statistics is None:
            return None
        contents = Contents(_told(file, summary))
    except (*_UNREADABLE, OSError, RecordingError):
        return None
    counts = _counts(summary, summary.statistics)
    if contents.skipped:
        return None
    measured = MEASURED_TOPIC in counts and SAMPLES_TOPIC not in counts
    return Glance(
        whole=True,
        samples=counts.get(MEASURED_TOPIC if measured else SAMPLES_TOPIC, 0),
        metadata=contents.metadata,
        events=tuple(contents.events),
        measured=measured,
    )


def _counts(summary: Summary, statistics: Statistics) -> dict[str, int]:
    """Messages by topic."""
    return {
        channel.topic: statistics.channel_message_counts.get(number, 0)
        for number, channel in summary.channels.items()
    }


def _told(file: IO[bytes], summary: Summary) -> Iterator[Item]:
    """Schemas and channels of events, metadata, and the chunks in which an event stands."""
    events = {n for n, channel in summary.channels.items() if channel.topic == EVENTS_TOPIC}
    for number in sorted(events):
        channel = summary.channels[number]
        if channel.schema_id in summary.schemas:
            yield summary.schemas[channel.schema_id]
        yield channel
    for place in summary.metadata_indexes:
        yield from _records(file, place.offset, place.length)
    for chunk in summary.chunk_indexes:
        if events & chunk.message_index_offsets.keys():
            yield from _records(file, chunk.chunk_start_offset, chunk.chunk_length)
    yield End(0, whole=True, lost_bytes=0)


def _records(file: IO[bytes], offset: int, length: int) -> Iterator[Item]:
    """What stands in a piece of the file, by the same walk as a whole one."""
    if not RECORD_HEAD <= length <= MAX_CHUNK_BYTES:
        raise ValueError(f"a record of {length} bytes")
    file.seek(offset)
    data = file.read(length)
    if len(data) != length:
        raise EOFError
    yield from (item for item in scan(MAGIC + data) if not isinstance(item, End))


def _by_walking(path: Path) -> Glance:
    contents = contents_of(read_bytes(path), path)
    topics = contents.topics
    measured = MEASURED_TOPIC in topics and SAMPLES_TOPIC not in topics
    rows = len(next(iter(contents.measured.columns().values()), ())) if measured else 0
    return Glance(
        whole=not contents.cut,
        samples=rows or int(contents.rows.size),
        metadata=contents.metadata,
        events=tuple(contents.events),
        measured=measured,
    )
