"""The small files beside a recording x.mcap, which say what the recording itself cannot.

    x.mcap.notes.json      notes, tags, operator: what people wrote; the only place that has them
    x.json                 the figures of its analysis, as `servo-bench analyse --json` writes them
    x.html                 the report of its analysis
    x.mcap.diagnosis.json  the verdict, as `servo-bench diagnose --json` writes it
    x.mcap.diagnosis.html  the page of its diagnosis

Each is replaced whole or not at all.
"""

import errno
import json
import os
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from servo_bench.errors import RecordingError

MAX_BYTES = 8 << 20
LONGEST_NOTES = 100_000
MOST_TAGS = 64
LONGEST_TAG = 64


@dataclass(frozen=True, slots=True)
class Notes:
    """What people wrote about a recording."""

    notes: str = ""
    tags: tuple[str, ...] = ()
    operator: str = ""


class Beside(NamedTuple):
    """Where the companions of one recording are, or would be."""

    notes: Path
    figures: Path
    report: Path
    diagnosis: Path
    diagnosis_page: Path


def beside(recording: Path) -> Beside:
    """The companions of a recording, there or not."""
    return Beside(
        notes=recording.with_name(recording.name + ".notes.json"),
        figures=recording.with_suffix(".json"),
        report=recording.with_suffix(".html"),
        diagnosis=recording.with_name(recording.name + ".diagnosis.json"),
        diagnosis_page=recording.with_name(recording.name + ".diagnosis.html"),
    )


FIGURE = "vaf_same_order3_percent"
"""A figure that every analysis has: a file x.json without it is somebody else's."""


def companions(recording: Path) -> tuple[Path, ...]:
    """Of the files that can be beside a recording those that are there and are the bench's own:
    what a measurement was imported from may have its name."""
    at = beside(recording)
    own = (at.notes, at.diagnosis, at.diagnosis_page)
    analysed = (at.figures, at.report) if has_figures(at.figures) else ()
    return tuple(path for path in (*own, *analysed) if path.exists())


def has_figures(path: Path) -> bool:
    """Whether a file is there and holds the figures of an analysis."""
    try:
        return FIGURE in (read_json(path) or {})
    except RecordingError:
        return False


def make_way_for_figures(recording: Path) -> None:
    """Raise RecordingError where what no analysis wrote has the name of its figures or report."""
    at = beside(recording)
    if has_figures(at.figures):
        return
    for path, what in ((at.figures, "figures"), (at.report, "report")):
        if path.exists():
            raise RecordingError(
                f"{path} is there and holds no {what} of an analysis, which would take its place. "
                "Move it away, or give the recording another name."
            )


def read_notes(recording: Path) -> Notes:
    """What people wrote; empty where there is nothing. RecordingError for a file that is no such.

    A damaged file is never replaced by an empty one: its words may still be saved by hand.
    """
    path = beside(recording).notes
    table = read_json(path)
    if table is None:
        return Notes()
    match table:
        case {"notes": str(notes), "tags": list(tags), "operator": str(operator)}:
            return checked(Notes(notes, tuple(str(tag) for tag in tags), operator))
    raise RecordingError(
        f"{path} does not hold notes (text), tags (a list), and operator (text). Mend it, or move "
        "it away."
    )


def checked(notes: Notes) -> Notes:
    """Tags trimmed, each once, in order. RecordingError for what a catalogue does not take."""
    tags = tuple(dict.fromkeys(tag.strip() for tag in notes.tags if tag.strip()))
    bad = [tag for tag in tags if len(tag) > LONGEST_TAG or not tag.isprintable()]
    if bad or len(tags) > MOST_TAGS:
        raise RecordingError(
            f"tags {bad[:1] or len(tags)}: at most {MOST_TAGS} tags of at most {LONGEST_TAG} "
            "printable characters can be given. Shorten them, or write a note."
        )
    if len(notes.notes) > LONGEST_NOTES or len(notes.operator) > LONGEST_TAG:
        raise RecordingError(
            f"notes of {len(notes.notes)} and an operator of {len(notes.operator)} characters: at "
            f"most {LONGEST_NOTES} and {LONGEST_TAG}. Shorten them."
        )
    return Notes(notes.notes, tags, notes.operator.strip())


def write_notes(recording: Path, notes: Notes) -> None:
    """Write what people wrote; the recording need not be there yet. RecordingError as `checked`."""
    kept = checked(notes)
    table = {"notes": kept.notes, "tags": list(kept.tags), "operator": kept.operator}
    replace_json(beside(recording).notes, table)


def read_json(path: Path) -> dict[str, Any] | None:
    """The object in a companion; None where there is no file. RecordingError for anything else."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(handle, "rb") as file:
            data = file.read(MAX_BYTES + 1) or b""
    except FileNotFoundError:
        return None
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            return None  # the recording's own name leaves no room for it
        raise RecordingError(f"{path} cannot be read: {error.strerror}. See who may.") from error
    try:
        table = json.loads(data) if len(data) <= MAX_BYTES else None
    except (ValueError, RecursionError):
        table = None
    if not isinstance(table, dict):
        raise RecordingError(
            f"{path} is not a JSON object of at most {MAX_BYTES >> 20} MiB. Mend it, or move it "
            "away."
        )
    return table


def replace_json(path: Path, table: Mapping[str, Any]) -> None:
    """Write an object so that a reader finds the old file or the new one, whole."""
    text = json.dumps(table, indent=2, allow_nan=False) + "\n"
    replace(path, text.encode())


def replace(path: Path, content: bytes) -> None:
    """Put `content` in place of a file, in one step. RecordingError where it cannot be written."""
    part = ""
    try:
        handle, part = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".part")
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        Path(part).chmod(0o644)
        Path(part).replace(path)
    except OSError as error:
        if part:
            with suppress(OSError):
                Path(part).unlink()
        why = (error.strerror or str(error)).lower()
        raise RecordingError(
            f"{path} cannot be written: {why}. What was there is kept; make room, or "
            "see who may write there."
        ) from error
