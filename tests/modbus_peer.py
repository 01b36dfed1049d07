"""A slave on Modbus by hand: sockets, a pty, struct, and a check sum of its own; no library.

It keeps the generic profile's registers well enough to be enabled, and answers the target
velocity's digits as the motor's position: what comes back tells which request it answers.
"""

import os
import select
import socket
import struct
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field

UNIT = 1
STATES = {0x00: 0x250, 0x02: 0x250, 0x06: 0x231, 0x07: 0x233, 0x0F: 0x237, 0x80: 0x250}


def crc16(data: bytes) -> bytes:
    """Modbus's check sum, bit by bit (polynomial 0xA001, start 0xFFFF), low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc.to_bytes(2, "little")


def rtu_frame(pdu: bytes, unit: int = UNIT) -> bytes:
    """Unit, PDU, check sum."""
    body = bytes([unit]) + pdu
    return body + crc16(body)


def tcp_frame(pdu: bytes, transaction: int, unit: int = UNIT) -> bytes:
    """Header of seven bytes and PDU."""
    return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu


@dataclass
class Registers:
    """What the generic profile wants to find."""

    words: dict[int, int] = field(default_factory=lambda: dict(_DEFAULTS))
    states: dict[int, int] = field(default_factory=lambda: dict(STATES))
    """Controlword to statusword."""
    read_only: set[int] = field(default_factory=set)

    def answer(self, pdu: bytes) -> bytes:
        """The answer to a request, as the Modbus specification has it."""
        function = pdu[0]
        match function:
            case 3 | 4:
                address, count = struct.unpack(">HH", pdu[1:5])
                return self._read(function, address, count)
            case 16:
                address, count = struct.unpack(">HH", pdu[1:5])
                self._write(address, pdu[6:])
                return pdu[:5]
            case 6:
                self._write(int.from_bytes(pdu[1:3], "big"), pdu[3:5])
                return pdu
            case 23:
                read, count, address, _ = struct.unpack(">HHHH", pdu[1:9])
                self._write(address, pdu[10:])
                return self._read(function, read, count)
        return bytes([function | 0x80, 1])

    def _read(self, function: int, address: int, count: int) -> bytes:
        words = [self.words.get(address + place, 0) for place in range(count)]
        return struct.pack(f">BB{count}H", function, 2 * count, *words)

    def _write(self, address: int, data: bytes) -> None:
        for place, (word,) in enumerate(struct.iter_unpack(">H", data)):
            if address + place not in self.read_only:
                self.words[address + place] = word
        if 0x0100 in self.words:
            self.words[0x0200] = self.states[self.words[0x0100]]
        self.words[0x0203] = self.words.get(0x0101, 0)
        self.words[0x0204] = self.words.get(0x0102, 0)


_DEFAULTS = {
    0x0000: 0x5342,
    0x0001: 402,
    0x0012: 1,  # 65536 counts in a turn
    0x0017: 640,
    0x0019: 18_000,
    0x0200: 0x250,
}

Act = Callable[[int, bytes, bytes], list[bytes]]
"""(how many cyclic requests came before, frame asked, its good answer) -> frames to send."""


class HangUp(Exception):  # noqa: N818 - it is no error of ours
    """Raised by `act`: the connection is closed. With `for_good`, nobody listens any more."""

    def __init__(self, *, for_good: bool = False) -> None:
        super().__init__()
        self.for_good = for_good


class Peer:
    """Answers in a thread. `act` sees every cyclic request (function 23) and may misbehave."""

    def __init__(self, act: Act, *, near: int | None = None) -> None:
        """On the near end of a pty, or else on a free TCP port."""
        self.registers = Registers()
        self.cyclic = 0
        self.rtu = near is not None
        self.frame: Callable[[bytes, int], bytes] = (
            (lambda pdu, _: rtu_frame(pdu)) if self.rtu else tcp_frame
        )
        self._act = act
        self._near = near
        self._listener = None if self.rtu else socket.create_server(("127.0.0.1", 0))
        self.address = self._listener.getsockname() if self._listener else ("", 0)

    def serve(self, stop: int) -> None:
        """Until `stop` is readable."""
        if self._near is not None:
            self._converse(self._near, stop)
            return
        listener = self._listener
        while listener is not None and stop not in select.select([listener, stop], [], [])[0]:
            connection, _ = listener.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with connection:
                try:
                    if not self._converse(connection.fileno(), stop):
                        break
                except HangUp as told:
                    if told.for_good:
                        break
        if listener is not None:
            listener.close()

    def _converse(self, descriptor: int, stop: int) -> bool:
        """Answer until the master hangs up; False when it is to stop."""
        buffer = b""
        while True:
            ready, _, _ = select.select([descriptor, stop], [], [])
            if stop in ready:
                return False
            try:
                data = os.read(descriptor, 4096)
            except OSError:
                return True
            if not data:
                return True
            buffer += data
            while (length := self._length(buffer)) and len(buffer) >= length:
                frame, buffer = buffer[:length], buffer[length:]
                with suppress(OSError):  # a master that has gone hears nothing
                    os.write(descriptor, self._reply(frame))

    def _length(self, buffer: bytes) -> int:
        if not self.rtu:
            return 6 + int.from_bytes(buffer[4:6], "big") if len(buffer) >= 6 else 0
        if len(buffer) < 11:
            return 8 if len(buffer) >= 2 and buffer[1] in (3, 4, 6) else 0
        return {16: 9 + buffer[6], 23: 13 + buffer[10]}.get(buffer[1], 8)

    def _reply(self, frame: bytes) -> bytes:
        transaction = 0 if self.rtu else int.from_bytes(frame[:2], "big")
        pdu = frame[1:-2] if self.rtu else frame[7:]
        if self.rtu and crc16(frame[:-2]) != frame[-2:]:
            raise AssertionError(f"a wrong check sum from the master: {frame.hex(' ')}")
        good = self.frame(self.registers.answer(pdu), transaction)
        if pdu[0] != 23:
            return good
        number, self.cyclic = self.cyclic, self.cyclic + 1
        return b"".join(self._act(number, frame, good))


@contextmanager
def running(peer: Peer) -> Iterator[Peer]:
    """The peer in its thread."""
    stop, told = os.pipe()
    thread = threading.Thread(target=peer.serve, args=(stop,))
    thread.start()
    try:
        yield peer
    finally:
        os.write(told, b".")
        thread.join()
        os.close(stop)
        os.close(told)


@contextmanager
def tcp_listener() -> Iterator[socket.socket]:
    """A listening socket on a free port of loopback."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener


@contextmanager
def pty() -> Iterator[tuple[int, str]]:
    """The near end's descriptor of a raw pty, and the far end's name."""
    near, far = os.openpty()
    tty.setraw(far)
    try:
        yield near, os.ttyname(far)
    finally:
        os.close(near)
        os.close(far)
