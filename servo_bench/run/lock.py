"""A lock on a file that names its holder: one rig, one master on it.

The lock is flock(2)'s: it belongs to the open file, so it passes to a child that is given the
descriptor, lives as long as any process that holds it, and ends with the last of them, however
that one ends. The file's text says who it is. It binds the processes of one machine only.
"""

import fcntl
import json
import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from servo_bench.errors import BusyError, ConfigError, disk_is_full

SHARED_FOLDER = Path("/run/lock")
IDENTITY = ("interface", "host", "port", "channel", "device")
"""What tells one bus from another; the other options of `[bus]` only say how it is used."""
MAX_TEXT_BYTES = 4096
Bus = Mapping[str, str | int | float | bool]


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


@dataclass(frozen=True, slots=True)
class Holder:
    """Who has the lock. `url` is where a daemon can be asked."""

    what: str
    pid: int = field(default_factory=os.getpid)
    since_utc: str = field(default_factory=_now)
    url: str = ""

    def sentence(self) -> str:
        """The holder in words."""
        where = f", at {self.url}" if self.url else ""
        return f"{self.what} (process {self.pid}, since {self.since_utc}{where})"


class Lock:
    """A lock that is held; `descriptor` may be handed to a child, which then holds it as well."""

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path = path
        self.descriptor = descriptor

    def name(self, holder: Holder) -> None:
        """Write who holds it; a disk that is full leaves the old words."""
        text = json.dumps(asdict(holder)).encode()[:MAX_TEXT_BYTES]
        try:
            os.pwrite(self.descriptor, text.ljust(MAX_TEXT_BYTES), 0)
        except OSError as error:
            if not disk_is_full(error):
                raise

    def let_go(self) -> None:
        """Close this process's hold; another that shares the descriptor goes on holding."""
        os.close(self.descriptor)

    def release(self) -> None:
        """Take the file away and let go: for the last holder."""
        self.path.unlink(missing_ok=True)
        self.let_go()


def take(path: Path, holder: Holder) -> Lock:
    """Lock the file at `path`. BusyError naming the holder where it is locked already, ConfigError
    where it cannot be opened."""
    while True:
        descriptor = _opened(path, holder)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(descriptor)
            raise _busy(path, holder) from error
        if _is_still(path, descriptor):
            lock = Lock(path, descriptor)
            lock.name(holder)
            return lock
        os.close(descriptor)  # its last holder took the file away in between


def holder_of(path: Path) -> Holder | None:
    """Who has last written into the lock's file; None where nobody did."""
    try:
        with path.open("rb") as file:
            return Holder(**json.loads(file.read(MAX_TEXT_BYTES)))
    except (OSError, ValueError, TypeError):
        return None


def rig_lock_path(bus: Bus) -> Path:
    """The file whose lock is the right to be the master on that bus."""
    identity = "-".join(str(bus[key]) for key in IDENTITY if key in bus)
    folder = SHARED_FOLDER if os.access(SHARED_FOLDER, os.W_OK) else Path(tempfile.gettempdir())
    return folder / f"servo-bench-{re.sub('[^A-Za-z0-9.-]', '_', identity)}.lock"


@contextmanager
def holding_rig(bus: Bus, what: str) -> Iterator[Lock]:
    """Be the only master on a rig's bus; BusyError naming the other one where there is one."""
    lock = take(rig_lock_path(bus), Holder(what))
    try:
        yield lock
    finally:
        lock.release()


def _busy(path: Path, holder: Holder) -> BusyError:
    held = holder_of(path)
    who = held.sentence() if held else "a process that gave no name"
    return BusyError(
        f"{holder.what} cannot have {path.name}: it is held by {who}. Wait until that has ended, "
        "or stop it."
    )


def _opened(path: Path, holder: Holder) -> int:
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        if isinstance(error, PermissionError) and _another_holds(path):
            raise _busy(path, holder) from error
        raise ConfigError(
            f"the lock {path} cannot be opened: {error.strerror}. Where another user has left it, "
            "that user or root must remove it."
        ) from error


def _another_holds(path: Path) -> bool:
    """Whether a file that only another user may write is locked: reading is enough to ask."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def _is_still(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False
