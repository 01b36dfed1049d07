"""What a recording and the files beside it say, as a line of the catalogue.

Nothing here raises for what a file holds: whatever cannot be used becomes a sentence in the line.
"""

import json
import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path, PurePath
from typing import Any

from servo_bench.catalogue.beside import (
    FIGURE,
    LONGEST_NOTES,
    Notes,
    beside,
    read_json,
    read_notes,
)
from servo_bench.catalogue.run import LONGEST_TEXT, Run, State, plain, printable, run_id
from servo_bench.errors import RecordingError
from servo_bench.recording.format import (
    EXPERIMENT_METADATA,
    FORMAT_METADATA,
    PROVENANCE_METADATA,
    RECOVERY_METADATA,
    RIG_METADATA,
)
from servo_bench.recording.glance import Glance, glance
from servo_bench.recording.recording import Event

LONGEST_SENTENCE = 1000
UNUSABLE = (ArithmeticError, ValueError, TypeError, LookupError, RecursionError)
"""What the strangest content of a file may raise, whatever it is asked for."""
VERDICTS = ("named", "none", "unknown")


def run_of(folder: Path, file: PurePath, size: int, changed_s: float) -> Run:
    """The line of the recording `file` below `folder`; `changed_s` is the file's own time."""
    path = folder / file
    base = {
        "id": run_id(file),
        "name": printable(file.stem),
        "file": printable(file.as_posix(), 1000),
        "bytes": size,
    }
    told: dict[str, Any] = {}
    try:
        told = _companions(path)
        run = _run(path, {**base, **told}, changed_s)
        run.json()  # what cannot be written is told here, and not where it is kept
    except RecordingError as error:
        words = str(error).replace(str(path), file.name)
        return _unreadable({**base, **told}, words, changed_s)
    except UNUSABLE as error:
        words = f"it says what cannot be listed ({type(error).__name__}: {printable(error)})."
        return _unreadable(base, words, changed_s)
    return run


def _run(path: Path, told: Mapping[str, Any], changed_s: float) -> Run:
    facts = _facts(glance(path), changed_s)
    written = {key: told[key] for key in ("operator", "notes") if told[key]}
    name = facts.pop("name") or told["name"]
    return Run(**{**told, **facts, **written, "name": name})


def _unreadable(base: Mapping[str, Any], words: str, changed_s: float) -> Run:
    sentence = printable(words, LONGEST_SENTENCE)
    return Run(**base, state="unreadable", sentence=sentence, started_utc=_file_time(changed_s))


def _facts(found: Glance, changed_s: float) -> dict[str, Any]:
    experiment = _json(found, EXPERIMENT_METADATA)
    rig = _json(found, RIG_METADATA)
    facts = found.metadata.get(PROVENANCE_METADATA, {})
    missed = _missed(found.events)
    period_s = _number(experiment.get("period_s"))
    if period_s is None:
        period_s = _number(found.metadata.get(FORMAT_METADATA, {}).get("period_s"))
    state, sentence = _state(found)
    seconds = None if period_s is None else _number((found.samples + missed) * period_s)
    return {
        "state": state,
        "sentence": printable(sentence, LONGEST_SENTENCE),
        "started_utc": _started(facts, changed_s),
        "experiment": printable(experiment.get("name", "")),
        "excitation": _excitation(experiment.get("identification")),
        "rig": printable(rig.get("name", "")),
        "seconds": seconds,
        "missed": None if found.measured else missed,
        "name": printable(facts.get("run_name", "")),
        "operator": printable(facts.get("operator", "")),
        "notes": plain(str(facts.get("run_notes", "")))[:LONGEST_NOTES],
    }


def _state(found: Glance) -> tuple[State, str]:
    errors = [event for event in found.events if event.kind == "error"]
    if errors:
        return "faulted", errors[-1].text
    count = f"{found.samples} samples"
    if not found.whole:
        return "cut", f"The file ends before its run does: {count} can be saved or are written."
    if RECOVERY_METADATA in found.metadata:
        return "cut", f"Saved from a cut file: {count}."
    stops = [event for event in found.events if event.kind == "stop asked"]
    if stops:
        return "stopped", f"Stopped by {_who_asked(stops[0])} after {count}."
    missed = _missed(found.events)
    return "complete", f"{count}, {missed} slots missed."


def _who_asked(stop: Event) -> str:
    match stop.data:
        case {"by": str(by)} if by.strip():
            return printable(by)
        case _:
            return "the operator"


def _missed(events: Iterable[Event]) -> int:
    """Slots that the bus loop said it skipped."""
    total = 0
    for event in events:
        match event.data:
            case {"slot": int(slot), "to": int(until)} if event.kind == "slot skipped":
                total += max(0, until - slot)
    return total


def _started(facts: Mapping[str, str], changed_s: float) -> str:
    with suppress(ValueError, OverflowError):
        told = datetime.fromisoformat(facts.get("utc", ""))
        return _iso(told.replace(tzinfo=told.tzinfo or UTC).astimezone(UTC))
    return _file_time(changed_s)


def _file_time(changed_s: float) -> str:
    """A file's time; one that no calendar has is the end of time, so that no rule lets it go."""
    try:
        return _iso(datetime.fromtimestamp(changed_s, UTC))
    except (OverflowError, ValueError, OSError):
        return _iso(datetime.max.replace(tzinfo=UTC))


def _iso(when: datetime) -> str:
    return when.isoformat(timespec="seconds")


def _excitation(sequence: object) -> str:
    if not isinstance(sequence, dict):
        return ""
    amplitude = _number(sequence.get("amplitude_rad_s"))
    level = "" if amplitude is None else f" at {amplitude:.4g} rad/s"
    kind = sequence.get("kind", "m-sequence")
    return printable(f"{kind} {sequence.get('polynomial', '')}".strip() + level)


def _json(found: Glance, record: str) -> dict[str, Any]:
    with suppress(ValueError, RecursionError):
        table = json.loads(found.metadata.get(record, {}).get("json", "{}"))
        return table if isinstance(table, dict) else {}
    return {}


def _number(value: object) -> float | None:
    with suppress(TypeError, ValueError, OverflowError):
        number = float(value) if isinstance(value, int | float | str) else math.nan
        return number if math.isfinite(number) and number > 0.0 else None
    return None


def _companions(path: Path) -> dict[str, Any]:
    """Notes, figures, and verdict; what is damaged is said in the notes' place and not lost."""
    try:
        notes = read_notes(path)
    except RecordingError as error:
        notes = Notes(notes=printable(error, LONGEST_SENTENCE))
    return {
        "notes": plain(notes.notes),
        "tags": notes.tags,
        "operator": printable(notes.operator),
        "figures": _figures(beside(path).figures),
        **_verdict(beside(path).diagnosis),
    }


def _figures(path: Path) -> dict[str, Any]:
    """The scalars of an analysis; nothing where the file is another's."""
    table = _companion(path)
    if FIGURE not in table:
        return {}
    return {plain(name): plain(value) for name, value in table.items() if _is_scalar(value)}


def _is_scalar(value: object) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    return isinstance(value, int | bool) or (isinstance(value, str) and len(value) <= LONGEST_TEXT)


def _verdict(path: Path) -> dict[str, Any]:
    table = _companion(path)
    verdict, causes = table.get("verdict"), table.get("causes")
    named = [
        printable(cause["effect"])
        for cause in (causes if isinstance(causes, list) else [])
        if isinstance(cause, dict) and "effect" in cause
    ]
    return {"verdict": verdict if verdict in VERDICTS else None, "causes": tuple(named)}


def _companion(path: Path) -> dict[str, Any]:
    with suppress(RecordingError):
        return read_json(path) or {}
    return {}
