"""Reading a recording: the file's records become a value, or one error says why not."""

import json
import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from servo_bench.errors import ConfigError, RecordingError
from servo_bench.excitation.experiment import Experiment, Phase, experiment_from_table
from servo_bench.recording.contents import Contents
from servo_bench.recording.format import (
    DOCUMENT,
    EXPERIMENT_METADATA,
    FORMAT_METADATA,
    FORMAT_VERSION,
    MAX_FILE_BYTES,
    MEASURED_FIELDS,
    MEASURED_TOPIC,
    MIB,
    PLANT_METADATA,
    PROVENANCE_METADATA,
    RECOVERY_METADATA,
    REQUIRED_FIELDS,
    RIG_METADATA,
    SAMPLES_TOPIC,
)
from servo_bench.recording.plant import plant_from_table
from servo_bench.recording.recording import SAMPLE_FIELDS, Event, Recording
from servo_bench.recording.scan import MAGIC, scan
from servo_bench.rig import rig_from_table

Model = TypeVar("Model", bound=BaseModel)


def load(path: str | Path, *, allow_cut: bool = False) -> Recording:
    """The recording in the file at `path`.

    Rows come sorted by slot; of two with the same slot the later one in the file is dropped, which
    an event of kind "duplicate slots" says. A file that was cut or damaged is refused, with what
    can be saved of it in the message; `allow_cut` gives what there is, with `cut` set. Every
    failure is a RecordingError: no file, not MCAP, cut, damaged, a required field or fact missing.
    """
    name = Path(path)
    return recording_in(contents_of(read_bytes(name), name), name, allow_cut=allow_cut)


def read_bytes(path: Path) -> bytes:
    """The bytes of an MCAP file; RecordingError where there is none, or none that is read."""
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            data = file.read(size) if size <= MAX_FILE_BYTES else b""
    except OSError as error:
        raise RecordingError(
            f"{path} cannot be read: {error.strerror}. Give the path of a recording."
        ) from error
    if size > MAX_FILE_BYTES:
        raise RecordingError(
            f"{path} is larger than the {MAX_FILE_BYTES / MIB:.0f} MiB that are read at once. "
            f"Split it by time, or keep only the topics that {DOCUMENT} names."
        )
    if not data.startswith(MAGIC):
        begins = f"it begins with {data[:8].hex(' ')}" if data else "it is empty"
        raise RecordingError(
            f"{path} is not an MCAP file: {begins}, and MCAP with {MAGIC.hex(' ')}. "
            f"CSV, MAT, NPZ and the like become one by servo-bench import; {DOCUMENT} says how to "
            "write one."
        )
    return data


def contents_of(data: bytes, path: Path) -> Contents:
    """What is in those bytes; RecordingError with the file's name where it is not ours."""
    try:
        return Contents(scan(data))
    except RecordingError as error:
        raise RecordingError(
            f"{path} cannot be used: {error}. {DOCUMENT} says what a recording holds."
        ) from error


def recording_in(contents: Contents, path: Path, *, allow_cut: bool) -> Recording:
    """The recording that `contents` are; the errors are those of `load`."""
    try:
        recording = _recording(contents)
    except RecordingError as error:
        if contents.cut:
            raise RecordingError(
                f"{path} was cut or damaged, and nothing can be saved of it: {error}. Record again."
            ) from error
        raise RecordingError(
            f"{path} cannot be used: {error}. {DOCUMENT} says what a recording holds."
        ) from error
    if contents.cut and not allow_cut:
        raise RecordingError(_what_is_left(contents, recording, path))
    return recording


def _what_is_left(contents: Contents, recording: Recording, path: Path) -> str:
    if contents.skipped:
        where = f"is damaged: {contents.skipped[0].why}"
    else:
        where = f"was cut: its last whole record ends at byte {contents.end.offset}"
    return (
        f"{path} {where}. {len(recording)} samples ({duration_s(recording):.1f} s) and "
        f"{len(recording.events)} events can be saved: servo-bench recover {path}"
    )


def duration_s(recording: Recording) -> float:
    """From the first slot's ask to the end of the last slot, in seconds."""
    if "slot" not in recording:
        steps = np.diff(recording["t_s"])
        return float(steps[steps > 0.0].sum()) + recording.period_s * (len(recording) > 0)
    slots = recording["slot"]
    return (int(slots[-1]) - int(slots[0]) + 1) * recording.period_s if slots.size else 0.0


def _recording(contents: Contents) -> Recording:
    _check_format(contents.metadata.get(FORMAT_METADATA, {}))
    if MEASURED_TOPIC in contents.topics and SAMPLES_TOPIC not in contents.topics:
        return _measured(contents)
    _check_fields(contents)
    experiment = _fact(contents, "experiment", EXPERIMENT_METADATA, experiment_from_table)
    rig = _fact(contents, "rig", RIG_METADATA, rig_from_table)
    rows, dropped = _by_slot(contents.rows)
    return Recording(
        channels={
            name: np.ascontiguousarray(rows[name])
            for name, _ in SAMPLE_FIELDS
            if name in contents.fields
        },
        period_s=_period_s(contents, experiment),
        experiment=experiment,
        rig=rig,
        provenance=contents.metadata.get(PROVENANCE_METADATA, {}),
        events=(*contents.events, *dropped),
        cut=contents.cut or RECOVERY_METADATA in contents.metadata,
        fast=contents.fast.columns(),
    )


def _measured(contents: Contents) -> Recording:
    """Data from elsewhere: rows in the file's order, times as they came."""
    return Recording(
        channels=contents.measured.columns(),
        period_s=_period_s(contents, None),
        experiment=None,
        rig=None,
        provenance=contents.metadata.get(PROVENANCE_METADATA, {}),
        events=tuple(contents.events),
        cut=contents.cut or RECOVERY_METADATA in contents.metadata,
        plant=_fact(contents, "plant", PLANT_METADATA, plant_from_table),
    )


def _check_format(facts: Mapping[str, str]) -> None:
    version = facts.get("version", str(FORMAT_VERSION))
    if version != str(FORMAT_VERSION):
        raise RecordingError(
            f"its format is version {version!r}, and this servo-bench reads {FORMAT_VERSION}: use "
            "the servo-bench that its provenance names, or a newer one"
        )


def _check_fields(contents: Contents) -> None:
    if SAMPLES_TOPIC not in contents.topics:
        found = ", ".join(contents.topics[:8]) or "none"
        raise RecordingError(f"it has no channel {SAMPLES_TOPIC} (its channels: {found})")
    if not contents.fields and not contents.rows.size:
        raise RecordingError(f"there is no message on {SAMPLES_TOPIC}")
    missing = [name for name in REQUIRED_FIELDS if name not in contents.fields]
    if missing:
        raise RecordingError(f"{missing[0]} is missing in the messages on {SAMPLES_TOPIC}")
    if not contents.fields.intersection(MEASURED_FIELDS):
        raise RecordingError(
            f"nothing measured is in the messages on {SAMPLES_TOPIC}: one of "
            f"{', '.join(MEASURED_FIELDS)} must be there"
        )
    rows = contents.rows
    if (rows["slot"] < 0).any():
        raise RecordingError("slot is missing or negative in a message")
    if (rows["phase"] > max(Phase)).any():
        raise RecordingError(
            f"phase is {rows['phase'].max()} in a message, and at most {max(Phase):d}"
        )


def _fact(
    contents: Contents, key: str, record: str, parse: Callable[[dict[str, Any], str], Model]
) -> Model | None:
    """The experiment, rig or plant: from its metadata record, else from the message on /config."""
    try:
        text = contents.metadata.get(record, {}).get("json")
        table = contents.config.get(key) if text is None else json.loads(text)
        if table is None:
            return None
        if not isinstance(table, dict):
            raise RecordingError(f"{record} is a JSON {type(table).__name__} and not an object")
        return parse(table, record)
    except (ConfigError, ValueError, RecursionError, ArithmeticError) as error:
        raise RecordingError(f"{record} cannot be understood ({error})") from error


def _period_s(contents: Contents, experiment: Experiment | None) -> float:
    if experiment is not None:
        return experiment.period_s
    text = contents.metadata.get(FORMAT_METADATA, {}).get("period_s")
    if text is None:
        raise RecordingError(
            f"period_s is missing: it is in the experiment, or in the metadata {FORMAT_METADATA}"
        )
    try:
        period_s = float(text)
    except ValueError as error:
        raise RecordingError(f"period_s is {text[:40]!r}, and must be a number") from error
    if not 0.0 < period_s < math.inf:
        raise RecordingError(f"period_s is {period_s}, and must be above zero")
    return period_s


def _by_slot(rows: NDArray[np.void]) -> tuple[NDArray[np.void], tuple[Event, ...]]:
    """Rows in the order of their slots, each slot once, and the event that says which went."""
    steps = np.diff(rows["slot"])
    if (steps > 0).all():
        return rows, ()
    rows = rows[np.argsort(rows["slot"], kind="stable")]
    again = np.diff(rows["slot"], prepend=-1) == 0
    if not again.any():
        return rows, ()
    first = rows[again][0]
    event = Event(
        time_ns=max(int(first["asked_ns"]), 0),
        kind="duplicate slots",
        text=f"{again.sum()} samples came with the slot of another, the first with slot "
        f"{first['slot']}. Of each slot the first in the file was kept.",
        data={"dropped": int(again.sum()), "first_slot": int(first["slot"])},
    )
    return rows[~again], (event,)
