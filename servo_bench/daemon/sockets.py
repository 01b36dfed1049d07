"""A runner's socket in the file system: made by the daemon, found again by anybody who may."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SOCKET = "control.sock"
MAX_MESSAGE_BYTES = 65536


@contextmanager
def _socket_path(folder: Path) -> Iterator[str]:
    """The socket in `folder` by way of an open folder: a socket's own path may have 107 bytes."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{descriptor}/{SOCKET}"
    finally:
        os.close(descriptor)


def listening(folder: Path) -> socket.socket:
    """A socket in `folder` that peers can connect to from now on."""
    made = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with _socket_path(folder) as path:
        made.bind(path)
    made.listen()
    return made


def connected(folder: Path) -> socket.socket:
    """A connection to the runner of `folder`; OSError where none lives."""
    made = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        with _socket_path(folder) as path:
            made.connect(path)
    except OSError:
        made.close()
        raise
    return made


def run_folders(state: Path) -> list[Path]:
    """Folders of runs that are not over, where a runner may be asked to stop without a daemon.

    OSError where it may not be seen whether there are any.
    """
    try:
        return [folder for folder in (state / "runs").iterdir() if (folder / SOCKET).exists()]
    except FileNotFoundError:
        return []
