"""Saving what a cut or damaged recording still holds, record by record, into a new whole file."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import IO, cast

from mcap.records import Attachment, Channel, Metadata, Schema
from mcap.writer import Writer

from servo_bench import __version__
from servo_bench.errors import RecordingError
from servo_bench.recording.format import RECOVERY_METADATA
from servo_bench.recording.reader import contents_of, duration_s, read_bytes, recording_in
from servo_bench.recording.scan import Item, Messages, scan
from servo_bench.recording.sink import Sink


@dataclass(frozen=True, slots=True)
class Recovered:
    """What is in the new file.

    `lost_bytes` are the bytes of the old one that could not be read; `was_cut` is false where the
    old file was whole, so that there was nothing to recover.
    """

    samples: int
    seconds: float
    events: int
    lost_bytes: int
    was_cut: bool


def recover(path: str | Path, out: str | Path) -> Recovered:
    """Copy every record that can be read from `path` into the new file `out`.

    Channels and metadata that are not ours are copied too. Of the record in which a file was cut
    nothing is saved, but for a chunk: without compression the messages that are whole; with zstd
    or lz4 those in blocks that are whole (128 and 64 KiB), which a chunk of ours never fills.
    A recording that was recovered says so: `load` gives it with `cut` set.

    Raises RecordingError where there is nothing to save, and where `out` exists or cannot be
    written.
    """
    source, target = Path(path), Path(out)
    data = read_bytes(source)
    contents = contents_of(data, source)
    recording = recording_in(contents, source, allow_cut=True)
    if contents.cut and len(recording) == 0:
        raise RecordingError(f"{source} was cut before its first sample came. Record again.")
    notes = (
        [Metadata(RECOVERY_METADATA, {"file": source.name, "lost_bytes": str(contents.lost_bytes)})]
        if contents.cut
        else []
    )
    _write(target, chain(notes, scan(data)))
    return Recovered(
        samples=len(recording),
        seconds=duration_s(recording),
        events=len(recording.events),
        lost_bytes=contents.lost_bytes,
        was_cut=contents.cut,
    )


def _write(target: Path, items: Iterable[Item]) -> None:
    sink = Sink(target)
    try:
        _copy(items, sink)
        sink.sync()
    except BaseException as error:  # half a file is none, and would stand in the next one's way
        target.unlink(missing_ok=True)
        if not isinstance(error, OSError):
            raise
        raise RecordingError(
            f"{target} cannot be written: {error.strerror}. Make room, or give another folder."
        ) from error
    finally:
        sink.close()


def _copy(items: Iterable[Item], sink: Sink) -> None:
    writer = Writer(cast("IO[bytes]", sink), enable_data_crcs=True)
    writer.start(profile="", library=f"servo-bench {__version__}")
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    for item in items:
        match item:
            case Schema() if item.id not in schemas:
                schemas[item.id] = writer.register_schema(item.name, item.encoding, item.data)
            case Channel() if item.id not in channels:
                channels[item.id] = writer.register_channel(
                    item.topic, item.message_encoding, schemas.get(item.schema_id, 0), item.metadata
                )
            case Metadata():
                writer.add_metadata(item.name, item.metadata)
            case Attachment():
                writer.add_attachment(
                    item.create_time, item.log_time, item.name, item.media_type, item.data
                )
            case Messages() if item.channel_id in channels:
                _copy_messages(item, channels[item.channel_id], writer)
            case _:
                pass  # repeated in the file, or not readable
    writer.finish()


def _copy_messages(messages: Messages, channel: int, writer: Writer) -> None:
    for head, body in zip(messages.heads.tolist(), messages.bodies, strict=True):
        _, sequence, log_time, publish_time = head
        writer.add_message(channel, log_time, body.tobytes(), publish_time, sequence)
