"""The daemon's end of a runner's socket: its messages, its slot table, its end.

The descriptors that come with the table belong to the link: the table's memory is read, and its
stop word written, without any help of the runner, so that a stop works even if that one hangs.
"""

import asyncio
import json
import os
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from servo_bench.daemon.sockets import MAX_MESSAGE_BYTES, connected
from servo_bench.run.table import SlotTable

Message = dict[str, Any]


class RunnerLink:
    """A connection to a living runner, in the event loop that made it."""

    def __init__(
        self,
        folder: Path,
        took: Callable[[Message], None],
        gone: Callable[[], None],
    ) -> None:
        """Connect; OSError where no runner lives. `took` gets messages, `gone` is called once."""
        self._took = took
        self._gone = gone
        self._socket = connected(folder)
        self._socket.setblocking(False)
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._socket.fileno(), self._readable)
        self.table: SlotTable | None = None
        self.period_s = 0.0
        self.pid: int | None = None
        self.lock_descriptor: int | None = None
        """The rig's lock as the runner holds it; whoever adopts it sets this to None."""

    def ask_stop(self, by: str) -> None:
        """Stop the rig: the word in shared memory first, then the words for the record."""
        if self.table is not None:
            self.table.ask_stop()
        with suppress(OSError):  # full or gone: its end is seen by the reader
            self._socket.send(json.dumps({"kind": "stop", "by": by}).encode())

    def close(self) -> None:
        """Let go of the socket and of what came with it; the runner goes on."""
        if self._socket.fileno() >= 0:
            self._loop.remove_reader(self._socket.fileno())
            self._socket.close()
        if self.table is not None:
            self.table.__exit__(None, None, None)
            self.table = None
        if self.lock_descriptor is not None:
            os.close(self.lock_descriptor)
            self.lock_descriptor = None

    def _readable(self) -> None:
        try:
            data, descriptors, _, _ = socket.recv_fds(self._socket, MAX_MESSAGE_BYTES, 2)
        except BlockingIOError:
            return
        except OSError:
            data, descriptors = b"", []
        if not data:
            self._loop.remove_reader(self._socket.fileno())
            self._gone()
            return
        message: Message = json.loads(data)
        if message["kind"] == "table" and len(descriptors) == 2:
            for descriptor in descriptors:
                os.set_inheritable(descriptor, False)
            self.table = SlotTable(descriptors[0], message["slots"])
            self.lock_descriptor = descriptors[1]
            self.period_s, self.pid = message["period_s"], message["pid"]
        self._took(message)
