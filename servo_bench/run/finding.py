"""What a check has found: the words of `preflight` and `doctor`."""

from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """How much it matters. CHANGE: the rig runs, but not as it should; STOP: it must not run."""

    OK = "ok"
    NOTE = "note"
    CHANGE = "change"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class Finding:
    """One line: how much it matters, what was looked at, and what was seen and what to do."""

    level: Level
    subject: str
    text: str


def ok(subject: str, text: str) -> Finding:
    """As it should be."""
    return Finding(Level.OK, subject, text)


def note(subject: str, text: str) -> Finding:
    """Good to know."""
    return Finding(Level.NOTE, subject, text)


def change(subject: str, text: str) -> Finding:
    """Should be changed."""
    return Finding(Level.CHANGE, subject, text)


def stop(subject: str, text: str) -> Finding:
    """Must be changed before the rig runs."""
    return Finding(Level.STOP, subject, text)
