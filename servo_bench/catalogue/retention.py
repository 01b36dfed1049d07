"""Which recordings a rule lets go, and letting them go: two steps, with a person between them.

A rule names an age and the tags that keep. What has no readable start, started in the future (a
clock was set back), or could not be read at all is never let go by a rule.
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta

from servo_bench.catalogue.beside import companions
from servo_bench.catalogue.catalogue import Catalogue
from servo_bench.catalogue.run import Run
from servo_bench.errors import ConfigError, RecordingError

UNITS_S = {"h": 3600.0, "d": 86400.0, "w": 7 * 86400.0, "y": 365.25 * 86400.0}


@dataclass(frozen=True, slots=True)
class Pruned:
    """How many recordings went, how many bytes with them, and what could not go."""

    deleted: int
    bytes: int
    kept: tuple[str, ...]


def age(text: str) -> timedelta:
    """An age such as "90d", "12w", "2y", "36h". ConfigError for anything else."""
    number, unit = text.strip()[:-1], text.strip()[-1:]
    with suppress(ValueError, OverflowError):
        if unit in UNITS_S and float(number) > 0.0:
            return timedelta(seconds=float(number) * UNITS_S[unit])
    raise ConfigError(
        f"{text!r} is no age: give a number and one of {', '.join(UNITS_S)} (hours, days, weeks, "
        "years), such as 90d."
    )


def let_go(
    runs: Iterable[Run], older_than: timedelta, keep_tags: Sequence[str], now: datetime
) -> list[Run]:
    """The runs that the rule lets go, the oldest first; nothing is touched."""
    found = []
    for run in runs:
        started = datetime.fromisoformat(run.started_utc)
        kept = run.state == "unreadable" or set(keep_tags) & set(run.tags)
        if not kept and started <= now and now - started > older_than:
            found.append(run)
    return sorted(found, key=lambda run: run.started_utc)


def delete(catalogue: Catalogue, runs: Iterable[Run]) -> Pruned:
    """Delete recordings with the bench's own files beside them; one that has changed since, and
    what is somebody else's, is kept."""
    deleted, size = 0, 0
    kept: list[str] = []
    for run in runs:
        try:
            if catalogue.get(run.id) != run:
                kept.append(f"{run.file} has changed since it was listed")
                continue
            path = catalogue.path(run.id)
            for file in (*companions(path), path):
                file.unlink(missing_ok=file != path)
        except RecordingError as error:
            kept.append(str(error))
        except OSError as error:
            kept.append(f"{run.file} cannot be deleted: {error.strerror}")
        else:
            deleted, size = deleted + 1, size + run.bytes
    catalogue.refresh()
    return Pruned(deleted, size, tuple(kept))
