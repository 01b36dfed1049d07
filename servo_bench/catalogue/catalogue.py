"""The catalogue of a folder of recordings.

    catalogue = Catalogue(Path("recordings"))
    catalogue.refresh()
    catalogue.search("backlash", tag="reference").runs[0].sentence

Every method may be called from any thread and process at once. What the index says can be a moment
old; `path` and `get` look at the file system again.
"""

import os
import stat
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

from servo_bench.catalogue.beside import beside, read_notes, replace_json, write_notes
from servo_bench.catalogue.index import NAME, Index
from servo_bench.catalogue.reading import run_of
from servo_bench.catalogue.run import Run, run_id
from servo_bench.errors import ConfigError, RecordingError

ENDING = ".mcap"
BATCH = 200
"""Recordings read between two writes: others see a long refresh grow."""
LARGEST_LIMIT = 10_000
INSERT = "INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?, ?, ?, ?)"


@dataclass(frozen=True, slots=True)
class Refreshed:
    """What a refresh has found."""

    added: int
    changed: int
    removed: int
    unchanged: int


@dataclass(frozen=True, slots=True)
class Page:
    """Some of the runs that a search found, the latest first, and how many there are in all."""

    total: int
    runs: tuple[Run, ...]


@dataclass(frozen=True, slots=True)
class _Found:
    """A recording in the folder; `stamp` changes with it and with the files beside it."""

    file: PurePosixPath
    size: int
    changed_s: float
    stamp: str

    @property
    def id(self) -> str:
        return run_id(self.file)


class Catalogue:
    """The recordings (*.mcap) in `folder` and below it; symbolic links are not followed.

    `index` is the SQLite file, by default `.servo-bench-catalogue.sqlite` in the folder. Raises
    ConfigError where there is no such folder.
    """

    def __init__(self, folder: Path, index: Path | None = None) -> None:
        if not folder.is_dir():
            raise ConfigError(f"there is no folder {folder}: give the folder of the recordings.")
        self.folder = folder.resolve()
        self._index = Index(index or self.folder / NAME)

    def refresh(self) -> Refreshed:
        """Read what is new or has changed, and forget what is gone."""
        there = {found.id: found for found in self._there()}
        with self._index.reading() as connection:
            known = dict(connection.execute("SELECT id, stamp FROM runs").fetchall())
        stale = [found for found in there.values() if known.get(found.id) != found.stamp]
        for start in range(0, len(stale), BATCH):
            self._read(stale[start : start + BATCH])
        removed = self._forget(known.keys() - there.keys())
        added = sum(found.id not in known for found in stale)
        return Refreshed(added, len(stale) - added, removed, len(there) - len(stale))

    def rebuild(self) -> Refreshed:
        """Read every recording again, into a new index where the old one is damaged."""
        self._index.doubt()
        return self.refresh()

    def search(
        self, q: str | None = None, tag: str | None = None, limit: int = 50, offset: int = 0
    ) -> Page:
        """Runs in whose texts every word of `q` occurs, and that have the tag; the latest first."""
        where, values = _condition(q, tag)
        window = (min(max(limit, 0), LARGEST_LIMIT), max(offset, 0))
        with self._index.reading() as connection:
            (total,) = connection.execute(
                f"SELECT count(*) FROM runs {where}",  # noqa: S608 - of constants, values bound
                values,
            ).fetchone()
            rows = connection.execute(
                f"SELECT row FROM runs {where} ORDER BY started DESC, id LIMIT ? OFFSET ?",  # noqa: S608
                (*values, *window),
            ).fetchall()
        return Page(int(total), tuple(Run.from_json(row) for (row,) in rows))

    def all(self) -> Iterator[Run]:
        """Every run, the latest first."""
        with self._index.reading() as connection:
            for (row,) in connection.execute("SELECT row FROM runs ORDER BY started DESC, id"):
                yield Run.from_json(row)

    def get(self, number: str) -> Run:
        """The run of that id, as the files are now. RecordingError where there is none."""
        return self._again(self._file(number))

    def path(self, number: str) -> Path:
        """The recording of that id. RecordingError where there is none, or it has been deleted."""
        return self.folder / self._file(number)

    def id_of(self, recording: Path) -> str:
        """The id of a recording in this folder, there or not. RecordingError for one elsewhere."""
        path = recording if recording.is_absolute() else Path.cwd() / recording
        try:
            below = (path.parent.resolve() / path.name).relative_to(self.folder)
        except ValueError as error:
            raise RecordingError(
                f"{recording} is not in the catalogue's folder {self.folder}. Move it there, or "
                "give its own folder."
            ) from error
        return run_id(below)

    def annotate(
        self,
        number: str,
        notes: str | None = None,
        tags: Sequence[str] | None = None,
        operator: str | None = None,
    ) -> Run:
        """Write notes, tags, or operator beside the recording; None leaves each as it is.

        RecordingError where there is no such run, or the notes cannot be kept.
        """
        file = self._file(number)
        given = {"notes": notes, "operator": operator, "tags": None if tags is None else (*tags,)}
        changes: dict[str, Any] = {
            name: value for name, value in given.items() if value is not None
        }
        with self._index.locked():
            write_notes(self.folder / file, replace(read_notes(self.folder / file), **changes))
        return self._again(file)

    def store_figures(self, number: str, numbers: Mapping[str, Any]) -> Run:
        """Keep an analysis (`Analysis.numbers()`) beside its recording. Errors as `annotate`."""
        file = self._file(number)
        replace_json(beside(self.folder / file).figures, numbers)
        return self._again(file)

    def store_diagnosis(self, number: str, numbers: Mapping[str, Any]) -> Run:
        """Keep a verdict (`Verdict.numbers()`) beside its recording. Errors as `annotate`."""
        file = self._file(number)
        replace_json(beside(self.folder / file).diagnosis, numbers)
        return self._again(file)

    def _file(self, number: str) -> PurePosixPath:
        """The path below the folder of the run of that id, which is a regular file there."""
        with self._index.reading() as connection:
            row = connection.execute("SELECT path FROM runs WHERE id = ?", (number,)).fetchone()
        if row is None:
            raise RecordingError(
                f"there is no run {number[:40]!r} in the catalogue of {self.folder}. Search for "
                "it, or refresh the catalogue."
            )
        file = PurePosixPath(os.fsdecode(row[0]))
        if self._looked_at(file) is None:
            self._forget({number})
            raise RecordingError(
                f"the recording of run {number} was deleted from {self.folder}. It is no longer in "
                "the catalogue."
            )
        return file

    def _again(self, file: PurePosixPath) -> Run:
        """The run of a file, read again where it has changed."""
        found = self._looked_at(file)
        if found is None:
            raise RecordingError(f"{self.folder / file} was deleted just now.")
        with self._index.reading() as connection:
            row = connection.execute(
                "SELECT row FROM runs WHERE id = ? AND stamp = ?", (found.id, found.stamp)
            ).fetchone()
        return Run.from_json(row[0]) if row else self._read([found])[0]

    def _read(self, stale: Sequence[_Found]) -> list[Run]:
        """Read recordings and write their rows."""
        runs = [run_of(self.folder, f.file, f.size, f.changed_s) for f in stale]
        rows = [
            (
                run.id,
                os.fsencode(f.file),
                f.stamp,
                run.started_utc,
                run.words,
                _tags(run),
                run.json(),
            )
            for f, run in zip(stale, runs, strict=True)
        ]
        with self._index.writing() as connection:
            connection.executemany(INSERT, rows)
        return runs

    def _forget(self, numbers: set[str]) -> int:
        """Take rows out whose files are gone; another process may have seen one come back."""
        if not numbers:
            return 0
        with self._index.writing() as connection:
            rows = connection.execute("SELECT id, path FROM runs").fetchall()
            gone = [
                (number,)
                for number, path in rows
                if number in numbers and self._looked_at(PurePosixPath(os.fsdecode(path))) is None
            ]
            connection.executemany("DELETE FROM runs WHERE id = ?", gone)
        return len(gone)

    def _there(self) -> Iterator[_Found]:
        """Every recording below the folder."""
        for root, folders, _ in os.walk(self.folder):
            folders[:] = [name for name in folders if not name.startswith(".")]
            below = PurePosixPath(Path(root).relative_to(self.folder))
            try:
                with os.scandir(root) as entries:
                    files = {entry.name: entry for entry in entries}
            except OSError:
                continue  # it was taken away just now, or may not be read: as os.walk has it
            for name in files:
                if name.lower().endswith(ENDING):
                    found = _found(below / name, {n: files[n] for n in _group(name) if n in files})
                    if found is not None:
                        yield found

    def _looked_at(self, file: PurePosixPath) -> _Found | None:
        """One recording as it is now; None where it is no regular file reached without a link."""
        path = self.folder / file
        if path.parent.resolve() != path.parent:
            return None
        return _found(file, {name: path.with_name(name) for name in _group(file.name)})


def _group(name: str) -> tuple[str, ...]:
    """The names of a recording and of the files beside it that the catalogue reads."""
    places = beside(Path(name))
    return (name, places.notes.name, places.figures.name, places.diagnosis.name)


def _found(file: PurePosixPath, places: Mapping[str, "os.DirEntry[str] | Path"]) -> _Found | None:
    stamps: list[str] = []
    own: os.stat_result | None = None
    for name, place in places.items():
        try:
            facts = place.stat(follow_symlinks=False)
        except OSError:
            continue
        stamps.append(f"{facts.st_size}:{facts.st_mtime_ns}:{facts.st_ctime_ns}:{facts.st_ino}")
        if name == file.name:
            own = facts
    if own is None or not stat.S_ISREG(own.st_mode):
        return None
    return _Found(file, own.st_size, own.st_mtime, " ".join(stamps))


def _condition(q: str | None, tag: str | None) -> tuple[str, tuple[str, ...]]:
    """The WHERE clause of a search, and what is bound to it."""
    clauses, values = [], []
    for word in (q or "").casefold().split():
        clauses.append("words LIKE ? ESCAPE '\\'")
        values.append("%" + "".join("\\" + c if c in "\\%_" else c for c in word) + "%")
    if tag:
        clauses.append("instr(tags, ?) > 0")
        values.append(f"\n{tag.strip()}\n")
    bound = tuple(value.encode(errors="replace").decode() for value in values)
    return ("WHERE " + " AND ".join(clauses) if clauses else ""), bound


def _tags(run: Run) -> str:
    return "".join(f"\n{tag}\n" for tag in run.tags)
