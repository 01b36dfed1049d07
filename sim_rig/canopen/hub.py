"""A CAN bus in a TCP port: a hub that speaks socketcand's raw mode on loopback.

Every client that opened the same channel hears every frame of the others, in one order, each
stamped once with the microsecond in which the kernel had it, however late the hub has its turn. A
client never hears itself. Who does not read is dropped; what is malformed is answered and
forgotten.

Runs as a process of its own, `python -m sim_rig.canopen.hub --port 0`, and prints its address as
one line of JSON.
"""

import argparse
import ipaddress
import json
import os
import selectors
import signal
import socket
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

from sim_rig.canopen import socketcand
from sim_rig.canopen.arrival import note_arrivals, receive
from sim_rig.errors import RigSettingsError, SimRigError
from sim_rig.realtime import end_with_parent, run_in_real_time

PRIORITY = 75
BACKLOG_BYTES = 1_000_000
SETTLE_S = 0.1
"""How long a new client's frames wait for it.

python-can's client wants `< ok >` alone in its first read, so frames follow when it has spoken
itself, or after this time. They are kept, and carry the time at which they were sent."""


def wall_clock_us() -> Callable[[], int]:
    """A clock in microseconds since the epoch that never jumps: anchored once, then monotonic."""
    anchor_ns = time.time_ns() - time.monotonic_ns()
    return lambda: (anchor_ns + time.monotonic_ns()) // 1000


def loopback_address(host: str) -> str:
    """The IPv4 loopback address that `host` names. Raises RigSettingsError for any other."""
    try:
        address = ipaddress.IPv4Address("127.0.0.1" if host == "localhost" else host)
    except ValueError:
        address = None
    if address is None or not address.is_loopback:
        raise RigSettingsError(
            f"bus host = {host!r}: the hub has no access control and serves this machine only. "
            "Use 127.0.0.1, or another address in 127.0.0.0/8."
        )
    return str(address)


@dataclass(eq=False, slots=True)
class _Client:
    sock: socket.socket
    inbox: bytearray = field(default_factory=bytearray)
    outbox: bytearray = field(default_factory=bytearray)
    channel: str | None = None
    raw: bool = False
    silent_until_s: float = 0.0
    events: int = selectors.EVENT_READ


class Hub:
    """The hub itself; `serve` runs until `close`. One thread. Raises SimRigError from the bind."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        address = loopback_address(host)
        self._clients: dict[int, _Client] = {}
        self._now_us = wall_clock_us()
        self._stamp_us = 0  # of the last frame: no stamp is of before it
        self._selector = selectors.DefaultSelector()
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind((address, port))
        except (OSError, OverflowError) as error:
            self.close()
            raise SimRigError(
                f"The bus hub cannot listen on {host}:{port}: {error}. "
                "Is another rig running there? Port 0 takes a free one."
            ) from error
        self._listener.listen()
        self._listener.setblocking(False)
        self._selector.register(self._listener, selectors.EVENT_READ)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port; the port is the one that was really taken."""
        host, port = self._listener.getsockname()
        return host, port

    def close(self) -> None:
        """Hang up on everybody."""
        for client in list(self._clients.values()):
            self._drop(client)
        self._selector.close()
        self._listener.close()

    def serve(self, stop: Callable[[], bool] = lambda: False) -> None:
        """Carry frames until `stop()`; it is asked after each event and at least every 0.05 s."""
        while not stop():
            self.step(0.05)

    def step(self, timeout_s: float) -> None:
        """Carry what has come, or wait for it `timeout_s`."""
        waiting = [c.silent_until_s for c in self._clients.values() if c.silent_until_s]
        if waiting:
            timeout_s = min(timeout_s, max(0.0, min(waiting) - time.monotonic()))
        for key, events in self._selector.select(timeout_s):
            if key.fileobj is self._listener:
                self._accept()
                continue
            client = self._clients.get(key.fd)
            if client is None:
                continue
            if events & selectors.EVENT_READ:
                self._read(client)
            if events & selectors.EVENT_WRITE:
                self._flush(client)
        if waiting:
            self._end_silences()

    def _accept(self) -> None:
        with suppress(BlockingIOError, ConnectionAbortedError):
            sock, _ = self._listener.accept()
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            note_arrivals(sock)
            client = _Client(sock)
            self._clients[sock.fileno()] = client
            self._selector.register(sock, client.events)
            self._say(client, socketcand.HI)

    def _drop(self, client: _Client) -> None:
        if self._clients.pop(client.sock.fileno(), None) is client:
            self._selector.unregister(client.sock)
            client.sock.close()

    def _read(self, client: _Client) -> None:
        try:
            chunk, unread_ns = receive(client.sock, 65536)
            client.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        except BlockingIOError:
            return
        except OSError:
            chunk, unread_ns = b"", 0
        if not chunk:
            self._drop(client)
            return
        self._stamp_us = max(self._stamp_us, self._now_us() - unread_ns // 1000)
        client.inbox += chunk
        heard: set[_Client] = set()
        for message in socketcand.take_messages(client.inbox):
            try:
                self._obey(client, socketcand.parse(message), heard)
            except socketcand.ProtocolError as error:
                self._say(client, socketcand.error_message(str(error)))
        for listener in heard:
            self._flush(listener)

    def _obey(self, client: _Client, message: socketcand.Message, heard: set[_Client]) -> None:
        match message:
            case socketcand.Send():
                if not client.raw:
                    raise socketcand.ProtocolError("open a channel and rawmode before send")
                client.silent_until_s = 0.0
                self._broadcast(client, message, heard)
            case socketcand.Open(channel):
                client.channel, client.raw = channel, False
                self._say(client, socketcand.OK)
            case socketcand.RawMode():
                if client.channel is None:
                    raise socketcand.ProtocolError("open a channel before rawmode")
                self._say(client, socketcand.OK)
                client.raw = True
                client.silent_until_s = time.monotonic() + SETTLE_S
            case socketcand.Echo():
                self._say(client, b"< echo >")

    def _broadcast(self, sender: _Client, frame: socketcand.Send, heard: set[_Client]) -> None:
        line = socketcand.frame_message(frame, self._stamp_us)
        for client in self._clients.values():
            if client.raw and client is not sender and client.channel == sender.channel:
                client.outbox += line
                heard.add(client)
        if sender.outbox:
            heard.add(sender)

    def _say(self, client: _Client, line: bytes) -> None:
        client.outbox += line
        self._flush(client)

    def _end_silences(self) -> None:
        now_s = time.monotonic()
        for client in list(self._clients.values()):
            if client.silent_until_s and client.silent_until_s <= now_s:
                client.silent_until_s = 0.0
                self._flush(client)

    def _flush(self, client: _Client) -> None:
        """Send what the socket takes; ask to be called again for the rest, up to the backlog."""
        if client.sock.fileno() not in self._clients:
            return
        if client.outbox and not client.silent_until_s:
            try:
                sent = client.sock.send(client.outbox)
            except BlockingIOError:
                sent = 0
            except OSError:
                self._drop(client)
                return
            del client.outbox[:sent]
        if len(client.outbox) > BACKLOG_BYTES:
            self._drop(client)
            return
        wanted = selectors.EVENT_READ
        if client.outbox and not client.silent_until_s:
            wanted |= selectors.EVENT_WRITE
        if client.events != wanted:
            self._selector.modify(client.sock, wanted)
            client.events = wanted


def main(arguments: list[str] | None = None) -> int:
    """The command line of the hub's process; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m sim_rig.canopen.hub", description=__doc__)
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=0, help="0 takes a free one")
    parser.add_argument("--parent", type=int, help="end when this process, the parent, ends")
    options = parser.parse_args(arguments)
    stopped = False

    def stop(*_: object) -> None:
        nonlocal stopped
        stopped = True

    signal.signal(signal.SIGTERM, stop)
    # Ctrl-C reaches a whole terminal; the bus must outlive the drives that are still stopping.
    signal.signal(signal.SIGINT, stop if options.parent is None else signal.SIG_IGN)
    if options.parent is not None and not end_with_parent(options.parent):
        return 1
    try:
        hub = Hub(options.host, options.port)
    except SimRigError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    host, port = hub.address
    sys.stdout.write(json.dumps({"host": host, "port": port, "pid": os.getpid()}) + "\n")
    sys.stdout.flush()
    run_in_real_time(PRIORITY)
    try:
        hub.serve(lambda: stopped)
    finally:
        hub.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
