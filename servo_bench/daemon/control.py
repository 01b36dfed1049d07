"""The runner's socket: shows the slot table to whoever connects, and takes a stop from them.

A Unix socket of whole messages (SOCK_SEQPACKET), JSON each. To a peer:

    {"kind": "table", "id", "slots", "period_s", "pid"}   with two descriptors: slot table, rig lock
    {"kind": "status", ...}                               about ten times a second
    {"kind": "result", ...}                               the last one

From a peer: {"kind": "stop", "by": "..."}; one that ends its side is let go when all that it said
was taken. Nothing here ever waits for a peer: what a full socket does not take is dropped, and the
next status says more.
"""

import json
import os
import selectors
import socket
import threading
from collections.abc import Callable, Mapping
from typing import Any

from servo_bench.clock import NS_PER_S, monotonic_ns
from servo_bench.daemon.sockets import MAX_MESSAGE_BYTES
from servo_bench.run.table import SlotTable

LOOK_EVERY_S = 0.1


class Control(threading.Thread):
    """Serves the socket in a thread of its own; `stop_asked` is what the session asks."""

    def __init__(
        self,
        listener: socket.socket,
        lock_descriptor: int,
        run_id: str,
        alone_for_s: float | None = None,
        now_ns: Callable[[], int] = monotonic_ns,
    ) -> None:
        """`alone_for_s`: stop the rig when nobody has been connected for so long; None never."""
        super().__init__(daemon=True, name="control")
        self._listener = listener
        self._lock_descriptor = lock_descriptor
        self._id = run_id
        self._alone_for_s = alone_for_s
        self._now_ns = now_ns
        self._seen_ns = now_ns()
        self._selector = selectors.DefaultSelector()
        self._peers: list[socket.socket] = []
        self._guard = threading.Lock()
        self._table: SlotTable | None = None
        self._greeting: bytes | None = None
        self._asked = False
        self.asked_by = ""

    @property
    def stop_asked(self) -> bool:
        """Whether a peer, a signal, or a peer with the table in its hands wants the rig stopped."""
        return self._asked or (self._table is not None and self._table.stop_asked)

    def ask_stop(self, by: str) -> None:
        """Stop the rig within a slot; the first who asks is remembered."""
        self.asked_by = self.asked_by or by
        self._asked = True
        table = self._table
        if table is not None:
            table.ask_stop()

    def show(self, table: SlotTable, period_s: float) -> None:
        """Let peers see this table from now on."""
        slots = len(table.rows)
        mine = SlotTable(os.dup(table.descriptor), slots)  # lives on when the session closes its
        hello = {"kind": "table", "id": self._id, "slots": slots, "period_s": period_s}
        with self._guard:
            self._table = mine
            self._greeting = json.dumps({**hello, "pid": os.getpid()}).encode()
            for peer in self._peers:
                self._greet(peer)
        if self._asked:
            mine.ask_stop()

    def tell(self, message: Mapping[str, Any]) -> None:
        """Send a message to every peer that can take it."""
        data = json.dumps(message).encode()
        with self._guard:
            for peer in self._peers:
                _send(peer, data)

    def run(self) -> None:
        """Until the process ends."""
        self._listener.setblocking(False)
        self._selector.register(self._listener, selectors.EVENT_READ)
        while True:
            for key, _ in self._selector.select(LOOK_EVERY_S):
                if key.fileobj is self._listener:
                    self._accept()
                elif isinstance(key.fileobj, socket.socket):
                    self._take(key.fileobj)
            self._mind_being_alone()

    def _accept(self) -> None:
        try:
            peer, _ = self._listener.accept()
        except BlockingIOError:
            return
        peer.setblocking(False)
        self._selector.register(peer, selectors.EVENT_READ)
        with self._guard:
            self._peers.append(peer)
            if self._greeting is not None:
                self._greet(peer)

    def _greet(self, peer: socket.socket) -> None:
        if self._table is not None and self._greeting is not None:
            try:
                descriptors = [self._table.descriptor, self._lock_descriptor]
                socket.send_fds(peer, [self._greeting], descriptors)
            except OSError:
                return  # it has gone again

    def _take(self, peer: socket.socket) -> None:
        try:
            data = _received(peer)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._selector.unregister(peer)
            with self._guard:
                self._peers.remove(peer)
            peer.close()
            return
        try:
            message = json.loads(data)
        except ValueError:
            return  # no peer of ours says that
        if isinstance(message, dict) and message.get("kind") == "stop":
            self.ask_stop(str(message.get("by", "")) or "an operator")

    def _mind_being_alone(self) -> None:
        if self._peers:
            self._seen_ns = self._now_ns()
        elif (
            self._alone_for_s is not None
            and self._now_ns() - self._seen_ns > self._alone_for_s * NS_PER_S
        ):
            self.ask_stop("the loss of the daemon")


def _received(peer: socket.socket) -> bytes:
    """What a peer said. One that left with words of ours unread resets the connection, which is
    told once and before its own last words: a stop among them must not be lost."""
    try:
        return peer.recv(MAX_MESSAGE_BYTES)
    except ConnectionResetError:
        return peer.recv(MAX_MESSAGE_BYTES)


def _send(peer: socket.socket, data: bytes) -> None:
    try:
        peer.send(data)
    except OSError:
        return  # full, or gone: it will miss this one
