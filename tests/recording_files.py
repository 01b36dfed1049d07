"""Rows and files that the recording tests share."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, IndexType, Writer
from numpy.typing import NDArray

from servo_bench.benchmark.recording import sample_rows
from servo_bench.excitation.experiment import Experiment, load_experiment
from servo_bench.recording.mcap_file import RecordingWriter
from servo_bench.recording.recording import SAMPLE_FIELDS, Event
from servo_bench.rig import RigConfig, load_rig

EXPERIMENT: Experiment = load_experiment("experiments/demo.toml")
RIG: RigConfig = load_rig("rigs/paper.toml")
FACTS = {"servo_bench": "0", "clock_monotonic_ns": "5", "clock_utc_ns": "1700000000000000005"}
EVENT = Event(10_000_000_007, "note", "half-way — ½", {"slots": [1, 2], "why": {"a": None}})
NAMES = [name for name, _ in SAMPLE_FIELDS]


def write(
    path: Path,
    rows: NDArray[np.void],
    events: tuple[Event, ...] = (),
    facts: Mapping[str, str] = FACTS,
) -> Path:
    """A file by our own writer, the events after the rows."""
    with RecordingWriter(path, EXPERIMENT, RIG, facts, 125.0) as writer:
        writer.samples(rows)
        for event in events:
            writer.event(event)
    return path


def rows(count: int, seed: int = 1) -> NDArray[np.void]:
    """Plausible rows, shape (count,)."""
    return sample_rows(seed, count, EXPERIMENT.period_s)


def strangers_file(
    path: Path,
    messages: list[bytes],
    *,
    encoding: str = "json",
    schema: str = "",
    chunked: bool = True,
    compression: CompressionType = CompressionType.ZSTD,
    indexed: bool = True,
    facts: Mapping[str, str] | None = None,
    experiment: Mapping[str, Any] | None = None,
    topic: str = "/samples",
) -> Path:
    """A file as another program would write it, a message of another channel after every tenth."""
    with path.open("xb") as file:
        writer = Writer(
            file,
            chunk_size=2000,
            compression=compression,
            use_chunking=chunked,
            index_types=IndexType.ALL if indexed else IndexType.NONE,
        )
        writer.start()
        writer.add_metadata("servo_bench.recording", dict(facts or {"period_s": "0.008"}))
        if experiment is not None:
            writer.add_metadata("servo_bench.experiment", {"json": json.dumps(experiment)})
        other = writer.register_channel("/camera", "jpeg", 0)
        schema_id = schema and writer.register_schema("x/msg/X", "ros2msg", schema.encode())
        channel = writer.register_channel(topic, encoding, schema_id or 0)
        for index, message in enumerate(messages):
            writer.add_message(channel, index, message, index, index)
            if index % 10 == 0:
                writer.add_message(other, index, b"\xff\xd8" * (index % 3), index, index)
        writer.finish()
    return path


def json_messages(table: NDArray[np.void], names: list[str]) -> list[bytes]:
    """Rows as JSON objects with the fields `names`, in that order."""
    return [json.dumps({name: row[name].item() for name in names}).encode() for row in table]
