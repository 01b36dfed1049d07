"""Everything the bench raises on purpose: one small tree.

    BenchError
    ├── ConfigError      a file or an option says something impossible         exit code 2
    ├── WireError        the bus, the cable, or a node does not answer         exit code 3
    ├── DriveError       the drive answered, and refused or faulted            exit code 4
    ├── LimitError       the rig left the limits of its configuration          exit code 5
    ├── RecordingError   a recording is missing, cut, or not one of ours       exit code 6
    ├── FitError         an estimate cannot be made from these data            exit code 7
    │   └── ChannelError     as a channel is not what the rig's file or the map says it is
    ├── RigError         the software rig failed or did not start              exit code 8
    └── BusyError        the rig, or what guards it, is in somebody's hands    exit code 9

`drivers` and `sim_rig` own errors of their own; `gathered()` turns them into these at the border.
A message says what happened, what was seen, what is allowed, and what to do next.
"""

import errno
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager

import drivers.errors
import sim_rig.errors

DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
SQLITE_DISK_FULL = (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR_SHMSIZE)
"""The second is what SQLite says where its shared memory, a file beside it, cannot grow."""


class BenchError(Exception):
    """Anything the bench raises on purpose. Its words are its message and its notes."""

    exit_code = 1

    def __str__(self) -> str:
        """Whoever tells what ended a run tells whether the drive confirmed its stop, too."""
        return _words(super().__str__(), self)


class ConfigError(BenchError):
    """A file or an option says something impossible."""

    exit_code = 2


class WireError(BenchError):
    """The bus, the cable, or a node on it does not answer."""

    exit_code = 3


class DriveError(BenchError):
    """The drive answered, and refused or faulted."""

    exit_code = 4


class LimitError(BenchError):
    """The rig left, or would leave, the limits of its configuration."""

    exit_code = 5


class RecordingError(BenchError):
    """A recording is missing, cut, or not one of ours."""

    exit_code = 6


class FitError(BenchError):
    """An estimate cannot be made from these data."""

    exit_code = 7


class ChannelError(FitError):
    """A channel is not what the rig's file or the map says: mend that, and record nothing."""


class RigError(BenchError):
    """The software rig failed or did not start."""

    exit_code = 8


class BusyError(BenchError):
    """The rig, or what guards it, is in somebody's hands; the message says in whose."""

    exit_code = 9


@contextmanager
def gathered() -> Iterator[None]:
    """Turn errors of `drivers` and `sim_rig` into the bench's own; message, notes, cause kept."""
    try:
        yield
    except drivers.errors.SettingsError as error:
        raise _as(ConfigError, error) from error
    except drivers.errors.WireError as error:
        raise _as(WireError, error) from error
    except drivers.errors.DriveError as error:
        raise _as(DriveError, error) from error
    except (sim_rig.errors.RigSettingsError, sim_rig.errors.EffectError) as error:
        raise _as(ConfigError, error) from error
    except sim_rig.errors.SimRigError as error:
        raise _as(RigError, error) from error


def _as(kind: type[BenchError], error: Exception) -> BenchError:
    """The bench's own error with the words of another; notes become part of them."""
    return kind(_words(str(error), error))


def _words(message: str, error: Exception) -> str:
    return " ".join([message, *getattr(error, "__notes__", ())])


def disk_is_full(error: BaseException) -> bool:
    """Whether an error, or what it was raised from, is that of a disk (or a quota) that is full."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in DISK_FULL:
            return True
        if isinstance(cause, sqlite3.Error):
            return getattr(cause, "sqlite_errorcode", None) in SQLITE_DISK_FULL
        cause = cause.__cause__
    return False
