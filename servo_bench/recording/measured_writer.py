"""Writing a recording from elsewhere, whole, into a new MCAP file.

Message times are `t_s` in nanoseconds, moved so that the first is not negative; a run that begins
before the one ahead of it has ended is put behind it, so that plots show one after the other.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

from servo_bench import __version__
from servo_bench.errors import RecordingError
from servo_bench.recording import cdr
from servo_bench.recording.format import (
    CONFIG_TOPIC,
    EVENTS_TOPIC,
    FORMAT_METADATA,
    FORMAT_VERSION,
    MEASURED_TOPIC,
    PLANT_METADATA,
    PROVENANCE_METADATA,
)
from servo_bench.recording.measured import TIME
from servo_bench.recording.recording import Recording
from servo_bench.recording.sink import Sink
from servo_bench.recording.writer import (
    CONFIG_SCHEMA,
    EVENT_SCHEMA,
    LAST_NS,
    event_json,
    json_bytes,
)

SCHEMA_NAME = "servo_bench_msgs/msg/Measured"


def save_measured(recording: Recording, path: str | Path) -> None:
    """Write a recording with a channel `t_s` to the new file `path`.

    Raises RecordingError where the file exists or cannot be written, and for a recording without
    `t_s` (a run is written by RecordingWriter, slot by slot).
    """
    if TIME not in recording:
        raise RecordingError(
            f"the recording has no channel {TIME}: it has {', '.join(recording.channels)}, and "
            "only data from elsewhere are written whole."
        )
    target = Path(path)
    sink = Sink(target)
    try:
        _write(recording, Writer(cast("IO[bytes]", sink)))
        sink.sync()
    except BaseException as error:
        target.unlink()
        if not isinstance(error, OSError):
            raise
        raise RecordingError(
            f"{target} cannot be written: {error.strerror}. Make room, or give another folder."
        ) from error
    finally:
        sink.close()


def _write(recording: Recording, writer: Writer) -> None:
    plant = recording.plant and recording.plant.model_dump(mode="json")
    writer.start(profile="", library=f"servo-bench {__version__}")
    facts = {"version": str(FORMAT_VERSION), "period_s": repr(recording.period_s)}
    writer.add_metadata(FORMAT_METADATA, facts)
    if plant is not None:
        writer.add_metadata(PLANT_METADATA, {"json": json_bytes(plant).decode()})
    writer.add_metadata(PROVENANCE_METADATA, dict(recording.provenance))
    events = _json_channel(writer, EVENTS_TOPIC, "servo_bench.Event", EVENT_SCHEMA)
    configs = _json_channel(writer, CONFIG_TOPIC, "servo_bench.Config", CONFIG_SCHEMA)
    times_ns = message_times_ns(recording)
    begin_ns = times_ns[0] if times_ns else 0
    config = {} if plant is None else {"plant": plant}
    writer.add_message(configs, begin_ns, json_bytes(config), begin_ns)
    for event in recording.events:
        writer.add_message(events, begin_ns, event_json(event), begin_ns)
    rows = _rows(recording)
    fields = [(name, rows.dtype[name].name) for name in rows.dtype.names or ()]
    schema = writer.register_schema(SCHEMA_NAME, "ros2msg", cdr.schema_text(fields).encode())
    measured = writer.register_channel(MEASURED_TOPIC, "cdr", schema)
    for row, (body, time_ns) in enumerate(zip(cdr.payloads(rows), times_ns, strict=True)):
        writer.add_message(measured, time_ns, body.tobytes(), time_ns, row & 0xFFFFFFFF)
    writer.finish()


def _json_channel(writer: Writer, topic: str, name: str, schema: Mapping[str, Any]) -> int:
    number = writer.register_schema(name, "jsonschema", json_bytes(schema))
    return writer.register_channel(topic, "json", number)


def _rows(recording: Recording) -> NDArray[np.void]:
    """The channels as rows of eight-byte fields, so that there is no padding."""
    kinds = [
        (name, "<f8" if values.dtype.kind == "f" else "<i8")
        for name, values in recording.channels.items()
    ]
    rows = np.zeros(len(recording), kinds)
    for name, values in recording.channels.items():
        rows[name] = values
    return rows


def message_times_ns(recording: Recording) -> list[int]:
    """When each row's message is, in nanoseconds, never falling."""
    t_s = recording[TIME]
    steps = np.diff(t_s)
    steps[steps < 0.0] = recording.period_s
    start_s = max(float(t_s[0]), 0.0) if t_s.size else 0.0
    if (np.diff(t_s) >= 0.0).all() and t_s.size:
        elapsed = t_s - t_s[0]  # no sum of rounded steps where none is needed
    else:
        elapsed = np.concatenate([np.zeros(min(t_s.size, 1)), np.cumsum(steps)])
    nanoseconds = np.rint((start_s + elapsed) * 1e9)
    times: list[int] = np.minimum(nanoseconds, float(LAST_NS // 2)).astype(np.int64).tolist()
    return times
