"""A new file whose every write reaches the operating system before it returns."""

import contextlib
import os
from pathlib import Path

from servo_bench.errors import RecordingError


class Sink:
    """What `mcap.writer.Writer` writes to: unbuffered, so that kill -9 loses nothing written.

    Not a `RawIOBase`, because the Writer puts a buffer of its own before one.
    """

    def __init__(self, path: Path) -> None:
        """Create `path`. Raises RecordingError where it exists or cannot be created."""
        try:
            self._file = path.open("xb", buffering=0)
        except FileExistsError as error:
            raise RecordingError(
                f"{path} exists, and a recording is never overwritten. Give another name, or "
                "move that file away."
            ) from error
        except OSError as error:
            raise RecordingError(
                f"{path} cannot be created: {error.strerror}. Give a folder that exists and may "
                "be written to."
            ) from error
        self._position = 0

    def write(self, data: bytes) -> int:
        """Write all of `data`; OSError where the disk does not take it."""
        rest = memoryview(data)
        while rest:
            written = os.write(self._file.fileno(), rest)
            self._position += written
            rest = rest[written:]
        return len(data)

    def tell(self) -> int:
        """How many bytes have been written."""
        return self._position

    def flush(self) -> None:
        """Nothing is held back."""

    def sync(self) -> None:
        """Wait until the disk has it; a file system that cannot sync is let be."""
        with contextlib.suppress(OSError):
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        self._file.close()
