"""The runs that wait, kept on disk: what was accepted is there after a restart, but held."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from servo_bench.daemon.problems import ApiError
from servo_bench.daemon.store import read_json, write_json
from servo_bench.errors import ConfigError

QUEUE = "queue.json"


@dataclass(frozen=True, slots=True)
class Waiting:
    """One run that somebody wants. `overrides` are those of the request."""

    id: str
    file: str
    name: str
    experiment: str
    operator: str
    notes: str = ""
    overrides: dict[str, Any] = field(default_factory=dict)


class Queue:
    """First come, first served; every change is on disk before it is true."""

    def __init__(self, folder: Path, longest: int) -> None:
        """Read what waited. ConfigError where the file is no queue."""
        self._path = folder / QUEUE
        self._longest = longest
        table = read_json(self._path)
        table = {"waiting": []} if table is None else table
        try:
            self._waiting = tuple(Waiting(**entry) for entry in table["waiting"])
        except (KeyError, TypeError) as error:
            raise ConfigError(
                f"{self._path} is no queue of this version: {error}. Move it away."
            ) from error

    def __len__(self) -> int:
        return len(self._waiting)

    def __iter__(self) -> Iterator[Waiting]:
        return iter(self._waiting)

    def add(self, entry: Waiting) -> int:
        """Put it at the end; how many are before it. ApiError where the queue is full."""
        if len(self._waiting) >= self._longest:
            raise ApiError(
                409,
                "queue-full",
                f"{self._longest} runs wait already, which is run.max_queue. Remove one first.",
            )
        self._keep((*self._waiting, entry))
        return len(self._waiting) - 1

    def first(self) -> Waiting | None:
        """Whose turn it is."""
        return self._waiting[0] if self._waiting else None

    def remove(self, run_id: str) -> Waiting | None:
        """Take it out; None where it does not wait."""
        found = next((entry for entry in self._waiting if entry.id == run_id), None)
        if found is not None:
            self._keep(tuple(entry for entry in self._waiting if entry is not found))
        return found

    def _keep(self, waiting: tuple[Waiting, ...]) -> None:
        write_json(self._path, {"waiting": [asdict(entry) for entry in waiting]})
        self._waiting = waiting
