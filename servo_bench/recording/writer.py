"""Writing a recording while it is made, so that kill -9 costs at most a second of it.

The metadata records, the schemas and the configuration are in the file before the first sample.
From then on the chunk in progress is closed about every half second, counted in rows and in the
samples' own time, and with every event; a closed chunk is with the operating system, whole.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self, cast

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

from servo_bench import __version__
from servo_bench.errors import RecordingError
from servo_bench.excitation.experiment import Experiment
from servo_bench.recording import cdr
from servo_bench.recording.alignment import Delay
from servo_bench.recording.format import (
    ALIGNMENT_METADATA,
    CONFIG_TOPIC,
    EVENTS_TOPIC,
    EXPERIMENT_METADATA,
    FAST_TOPIC,
    FORMAT_METADATA,
    FORMAT_VERSION,
    MAX_JSON_BYTES,
    MIB,
    PROVENANCE_METADATA,
    RIG_METADATA,
    SAMPLES_TOPIC,
)
from servo_bench.recording.provenance import utc_offset_ns
from servo_bench.recording.recording import FAST_DTYPE, FAST_FIELDS, SAMPLE_DTYPE, Event
from servo_bench.recording.sink import Sink
from servo_bench.rig import RigConfig

CHUNK_S = 0.5
LAST_NS = 2**63 - 1
EVENT_SCHEMA = {
    "type": "object",
    "properties": {
        "time_ns": {"type": "integer", "description": "CLOCK_MONOTONIC"},
        "kind": {"type": "string"},
        "text": {"type": "string"},
        "data": {"type": "object"},
    },
    "required": ["time_ns", "kind", "text"],
}
CONFIG_SCHEMA = {
    "type": "object",
    "properties": {"experiment": {"type": "object"}, "rig": {"type": "object"}},
}


class RecordingWriter:
    """A new recording file; a context manager, and leaving it completes the file.

    Times in the file are UTC: CLOCK_MONOTONIC moved by the clock pair in `provenance`. Every
    method raises RecordingError where the disk does not take the data; what was kept until then
    stays readable, and the error says how much that is.
    """

    def __init__(
        self,
        path: str | Path,
        experiment: Experiment | None,
        rig: RigConfig | None,
        provenance: Mapping[str, str],
        rows_per_second: float,
    ) -> None:
        """Create the file and write its head. RecordingError where `path` exists or cannot be."""
        self._path = Path(path)
        self._sink = Sink(self._path)
        self._writer = Writer(cast("IO[bytes]", self._sink), enable_data_crcs=True)
        self._failed: RecordingError | None = None
        self._offset_ns = utc_offset_ns(provenance)
        self._rows_per_chunk = max(1, math.floor(CHUNK_S * rows_per_second))
        self._open_rows = 0
        self._open_since_ns = 0
        self._kept_rows = 0
        period_s = experiment.period_s if experiment else 1.0 / rows_per_second
        try:
            self._guarded(self._write_head, period_s, experiment, rig, provenance)
        except RecordingError:
            self._sink.close()
            self._path.unlink()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if self._failed is None:
                self._guarded(self._finish)
        except RecordingError as failure:
            if error is None:
                raise
            error.add_note(str(failure))  # what ended the run matters more
        finally:
            self._sink.close()

    def samples(self, rows: NDArray[np.void]) -> None:
        """Append rows of SAMPLE_DTYPE, shape (n,), in the order of their slots."""
        if rows.dtype != SAMPLE_DTYPE:
            raise ValueError(f"rows are {rows.dtype}, and must be SAMPLE_DTYPE")
        self._guarded(self._write_rows, rows)

    def fast(self, rows: NDArray[np.void]) -> None:
        """Append rows of FAST_DTYPE, shape (n,), in order; before the samples of their slots."""
        if rows.dtype != FAST_DTYPE:
            raise ValueError(f"rows are {rows.dtype}, and must be FAST_DTYPE")
        self._guarded(self._write_fast, rows)

    def event(self, event: Event) -> None:
        """Append an event; it and every sample before it are with the operating system then."""
        self._guarded(self._write_event, event_json(event), self._utc_ns(event.time_ns))

    def alignment(self, delays: Sequence[Delay]) -> None:
        """Add when the samples were, against their asks; once, at the end."""
        facts = {delay.name: delay.facts() for delay in delays}
        self._guarded(self._writer.add_metadata, ALIGNMENT_METADATA, facts)

    def _guarded(self, act: Callable[..., None], *args: Any) -> None:
        """Do `act`; after a disk that refused once, nothing more is written."""
        if self._failed is not None:
            raise self._failed
        try:
            act(*args)
        except OSError as error:
            self._failed = RecordingError(
                f"{self._path} cannot be written any further: {error.strerror}. {self._kept_rows} "
                f"samples are kept, and {self._open_rows} after them are lost. Make room, then: "
                f"servo-bench recover {self._path}"
            )
            raise self._failed from error

    def _write_head(
        self,
        period_s: float,
        experiment: Experiment | None,
        rig: RigConfig | None,
        provenance: Mapping[str, str],
    ) -> None:
        config = {
            key: value.model_dump(mode="json")
            for key, value in (("experiment", experiment), ("rig", rig))
            if value is not None
        }
        text = json_bytes(config)
        if len(text) > MAX_JSON_BYTES:
            raise RecordingError(
                f"the experiment and the rig take {len(text) / MIB:.1f} MiB as JSON, and a "
                f"recording holds {MAX_JSON_BYTES // MIB}: nobody could read it again. Play fewer "
                "commands; split a recording that is to be replayed."
            )
        writer = self._writer
        writer.start(profile="", library=f"servo-bench {__version__}")
        facts = {"version": str(FORMAT_VERSION), "period_s": repr(period_s)}
        writer.add_metadata(FORMAT_METADATA, facts)
        for name, key in ((EXPERIMENT_METADATA, "experiment"), (RIG_METADATA, "rig")):
            if key in config:
                writer.add_metadata(name, {"json": json_bytes(config[key]).decode()})
        writer.add_metadata(PROVENANCE_METADATA, dict(provenance))
        sample = writer.register_schema(cdr.SCHEMA_NAME, "ros2msg", cdr.schema_text().encode())
        self._samples = writer.register_channel(SAMPLES_TOPIC, "cdr", sample)
        self._fast: int | None = None
        if rig is not None and rig.samples_per_command > 1:
            schema = cdr.schema_text(FAST_FIELDS).encode()
            fast = writer.register_schema(cdr.FAST_SCHEMA_NAME, "ros2msg", schema)
            self._fast = writer.register_channel(FAST_TOPIC, "cdr", fast)
        self._events = self._json_channel(EVENTS_TOPIC, "servo_bench.Event", EVENT_SCHEMA)
        configs = self._json_channel(CONFIG_TOPIC, "servo_bench.Config", CONFIG_SCHEMA)
        begin_ns = self._utc_ns(int(provenance.get("clock_monotonic_ns", 0)))
        writer.add_message(configs, begin_ns, text, begin_ns)
        self._close_chunk()

    def _json_channel(self, topic: str, name: str, schema: Mapping[str, Any]) -> int:
        number = self._writer.register_schema(name, "jsonschema", json_bytes(schema))
        return self._writer.register_channel(topic, "json", number)

    def _write_rows(self, rows: NDArray[np.void]) -> None:
        times_ns = np.maximum(rows["asked_ns"], 0).tolist()
        for payload, slot, asked_ns in zip(
            cdr.payloads(rows), rows["slot"].tolist(), times_ns, strict=True
        ):
            utc_ns = self._utc_ns(asked_ns)
            if self._open_rows == 0:
                self._open_since_ns = utc_ns
            self._open_rows += 1
            self._writer.add_message(
                self._samples, utc_ns, payload.tobytes(), utc_ns, slot & 0xFFFFFFFF
            )
            due = utc_ns - self._open_since_ns >= CHUNK_S * 1e9
            if due or self._open_rows >= self._rows_per_chunk:
                self._close_chunk()

    def _write_fast(self, rows: NDArray[np.void]) -> None:
        if self._fast is None:
            raise ValueError("this rig samples once per command: its file has no fast channel")
        times_ns = np.maximum(rows["asked_ns"], 0).tolist()
        for payload, asked_ns in zip(cdr.payloads(rows), times_ns, strict=True):
            utc_ns = self._utc_ns(asked_ns)
            self._writer.add_message(self._fast, utc_ns, payload.tobytes(), utc_ns)

    def _write_event(self, body: bytes, utc_ns: int) -> None:
        self._writer.add_message(self._events, utc_ns, body, utc_ns)
        self._close_chunk()

    def _close_chunk(self) -> None:
        self._writer.flush()
        self._kept_rows += self._open_rows
        self._open_rows = 0

    def _finish(self) -> None:
        self._close_chunk()
        self._writer.finish()
        self._sink.sync()

    def _utc_ns(self, monotonic_ns: int) -> int:
        """A time in the file, which holds none before 1970."""
        return min(max(monotonic_ns + self._offset_ns, 0), LAST_NS)


def event_json(event: Event) -> bytes:
    """An event as its message in a file."""
    body = {
        "time_ns": event.time_ns,
        "kind": event.kind,
        "text": event.text,
        "data": _plain(event.data),
    }
    return json_bytes(body)


def json_bytes(value: Any) -> bytes:
    """A value as compact JSON; ValueError where it holds what is not finite."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).encode()


def _plain(value: Any) -> Any:
    """`value` as JSON has it: numpy's numbers as numbers, what is not finite as null."""
    match value:
        case bool() | int() | str() | None:
            return value
        case float():
            return float(value) if math.isfinite(value) else None
        case np.generic() | np.ndarray():
            return _plain(value.tolist())
        case Mapping():
            return {str(key): _plain(entry) for key, entry in value.items()}
        case list() | tuple():
            return [_plain(entry) for entry in value]
        case _:
            return str(value)
