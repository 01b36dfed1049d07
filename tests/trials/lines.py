"""A campaign's lines on disk: one JSON object a trial, appended as it ends; a kill costs no other.

A line that was cut in the middle (no newline at its end, or no JSON) is the trial that was being
written: it is dropped when the file is opened again, and that trial is asked anew.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from servo_bench.errors import ConfigError
from tests.trials.drawing import Question, question_from


class Lines:
    """The file; a context manager, and while it is open every line is on the disk when it is in."""

    def __init__(self, path: Path, *, resume: bool) -> None:
        """Open or begin the file; ConfigError where it is there already and not to be resumed."""
        if path.exists() and not resume:
            raise ConfigError(
                f"{path} has the trials of a campaign already: give --resume to go on with it, or "
                "another --json."
            )
        self._path = path
        self._file: IO[str] | None = None
        self.lines = _whole_lines(path) if path.exists() else []

    def __enter__(self) -> Self:
        self._file = self._path.open("a", encoding="utf-8")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._file is not None:
            self._file.close()

    def append(self, line: Mapping[str, Any]) -> None:
        """Write a trial down, whole, before anything else happens."""
        if self._file is None:
            raise ValueError("lines are appended inside the context")
        text = json.dumps(line)
        self._file.write(text + "\n")
        self._file.flush()
        os.fsync(self._file.fileno())
        self.lines.append(json.loads(text))  # the same whether it was written now or before

    def answered(self) -> set[Question]:
        """The questions that have their line."""
        return {question_from(line["question"]) for line in self.lines}


def _whole_lines(path: Path) -> list[dict[str, Any]]:
    """The lines that are whole; what comes after the last of them is cut off the file."""
    raw = path.read_bytes()
    whole: list[dict[str, Any]] = []
    kept = 0
    for text in raw.splitlines(keepends=True):
        line = _parsed(text)
        if line is None:
            break
        whole.append(line)
        kept += len(text)
    if kept < len(raw):
        _refuse_more_than_one(raw[kept:], path)
        os.truncate(path, kept)
    return whole


def _parsed(text: bytes) -> dict[str, Any] | None:
    try:
        line = json.loads(text)
    except ValueError:
        return None
    return line if text.endswith(b"\n") and isinstance(line, dict) and "question" in line else None


def _refuse_more_than_one(tail: bytes, path: Path) -> None:
    """A kill cuts one line; anything else is somebody's file, and is left as it is."""
    if b"\n" in tail.rstrip(b"\n"):
        raise ConfigError(
            f"{path} has a line that is no trial, and others after it: it was damaged, or is not a "
            "campaign's. Mend or move it; nothing was changed."
        )
