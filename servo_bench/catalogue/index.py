"""The catalogue's SQLite file: one table, write-ahead log, and a new file where it is damaged.

    runs    id, path (bytes, as the file system has it), stamp, started, words, tags, row (JSON)

`stamp` is what the file system says of a recording and the files beside it; a recording is read
again where that changed in any way, so a clock that was set back hides nothing. A file of another
schema version or a damaged one is made anew: the recordings have all that was in it.
"""

import fcntl
import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from servo_bench.errors import ConfigError, RecordingError, disk_is_full

NAME = ".servo-bench-catalogue.sqlite"
SCHEMA_VERSION = 2
BUSY_S = 20.0
DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
SCHEMA = (
    """CREATE TABLE runs (
        id TEXT PRIMARY KEY,
        path BLOB NOT NULL,
        stamp TEXT NOT NULL,
        started TEXT NOT NULL,
        words TEXT NOT NULL,
        tags TEXT NOT NULL,
        row TEXT NOT NULL
    ) WITHOUT ROWID""",
    "CREATE INDEX by_start ON runs (started DESC, id)",
)


class Index:
    """Opens a connection for each piece of work, so that any thread or process may use it."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """A connection to ask. RecordingError or ConfigError where the file cannot be used."""
        with self._told(), closing(self._opened()) as connection:
            yield connection

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """One transaction: all that is written in it stays, or nothing. Errors as `reading`."""
        with self._told(), closing(self._opened()) as connection:
            connection.execute("BEGIN IMMEDIATE")
            try:
                yield connection
            except BaseException:
                with suppress(sqlite3.Error):  # a full disk has rolled back by itself
                    connection.execute("ROLLBACK")
                raise
            connection.execute("COMMIT")

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Alone among all processes, for what is no transaction of the database."""
        lock = self.path.with_name(self.path.name + ".lock")
        try:
            handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise _no_index(self.path, error, str(error.strerror)) from error
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
            yield
        finally:
            os.close(handle)

    def doubt(self) -> None:
        """Take every stamp away, so that all is read again; who reads meanwhile sees the old rows.

        A damaged file is thrown away.
        """
        try:
            with self.writing() as connection:
                connection.execute("UPDATE runs SET stamp = ''")
        except RecordingError:
            with self.locked():
                self._forget()

    def _forget(self) -> None:
        """Throw the file away; who has it open must open it again."""
        for ending in ("", "-wal", "-shm"):
            self.path.with_name(self.path.name + ending).unlink(missing_ok=True)

    def _opened(self) -> sqlite3.Connection:
        try:
            return self._connected()
        except sqlite3.DatabaseError as error:
            if getattr(error, "sqlite_errorcode", 0) & 0xFF not in DAMAGED:
                raise
        with self.locked():
            try:
                return self._connected()  # another process was faster
            except sqlite3.DatabaseError:
                self._forget()
                return self._connected()

    def _connected(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self.path, BUSY_S, isolation_level=None)
        try:
            if _version(connection) != SCHEMA_VERSION:
                self._renew(connection)
            connection.execute("PRAGMA synchronous = NORMAL")
        except BaseException:
            connection.close()
            raise
        return connection

    @staticmethod
    def _renew(connection: sqlite3.Connection) -> None:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("BEGIN IMMEDIATE")
        if _version(connection) != SCHEMA_VERSION:  # else another process was faster
            connection.execute("DROP TABLE IF EXISTS runs")
            for statement in SCHEMA:
                connection.execute(statement)
            connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        connection.execute("COMMIT")

    @contextmanager
    def _told(self) -> Iterator[None]:
        """SQLite's errors in words."""
        try:
            yield
        except sqlite3.OperationalError as error:
            raise _no_index(self.path, error, str(error)) from error
        except sqlite3.DatabaseError as error:
            raise RecordingError(
                f"the catalogue {self.path} is damaged ({error}). No recording is: make it anew "
                "with servo-bench catalogue rebuild."
            ) from error


def _version(connection: sqlite3.Connection) -> int:
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    return int(version)


def _no_index(path: Path, error: Exception, words: str) -> ConfigError:
    why = "the disk is full" if disk_is_full(error) else words  # SQLite may call it an I/O error
    return ConfigError(
        f"the catalogue's index {path} cannot be used: {why}. See who may write there, make room, "
        "or give another place with --index; the recordings are not touched."
    )
