"""Modbus TCP: an answer belongs to a request when it carries its transaction id.

The id grows with every request, so an answer that comes after its request was given up never
fits a later one (65535 requests must pass before an id returns). Frames may come in pieces or
several at once.
"""

import socket

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU

from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.errors import WireError
from drivers.modbus.frames import belongs
from drivers.modbus.lines import TcpLine
from drivers.modbus.link import Reply, readable

_HEADER = 6  # transaction id, protocol id, length: two bytes each
_SHORTEST, _LONGEST = 2, 254
_LAST_ID = 0xFFFF


class TcpLink:
    """A connection to one drive; see `drivers.modbus.link`. WireError where nobody listens."""

    def __init__(self, line: TcpLine, unit: int, clock: Clock = SYSTEM_CLOCK) -> None:
        self.name = f"drive {unit} at {line.name}"
        self.strays = 0
        self.damaged = 0
        self._unit = unit
        self._clock = clock
        self._framer = FramerSocket(DecodePDU(is_server=False))
        self._buffer = bytearray()
        self._request: ModbusPDU | None = None
        self._last_id = 0
        self._socket = _connect(line, self.name)

    def begin(self, request: ModbusPDU) -> int:
        """Send a request; see `Link.begin`."""
        self._last_id = self._last_id % _LAST_ID + 1
        request.dev_id, request.transaction_id = self._unit, self._last_id
        frame = self._framer.buildFrame(request)
        self._request = request
        sent_ns = self._clock.now_ns()
        try:
            taken = self._socket.send(frame)
        except OSError as error:
            raise self._gone(error) from error
        if taken != len(frame):
            raise self._gone("it takes no more bytes")
        return sent_ns

    def poll(self, until_ns: int) -> Reply | None:
        """The answer to the open request; see `Link.poll`."""
        while True:
            pdu = self._next_answer()
            if pdu is not None:
                self._request = None
                return Reply(pdu, self._clock.now_ns())
            if not readable(self._socket.fileno(), until_ns, self._clock):
                return None
            self._read()

    def abandon(self) -> None:
        """Give the open request up: its id is never waited for again."""
        self._request = None

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def _read(self) -> None:
        try:
            data = self._socket.recv(4096)
        except BlockingIOError:
            return
        except OSError as error:
            raise self._gone(error) from error
        if not data:
            raise self._gone("the drive closed the connection")
        self._buffer += data

    def _next_answer(self) -> ModbusPDU | None:
        """Take whole frames from the buffer until one is the answer."""
        buffer = self._buffer
        while len(buffer) >= _HEADER:
            length = int.from_bytes(buffer[4:6], "big")
            if buffer[2:4] != b"\0\0" or not _SHORTEST <= length <= _LONGEST:
                raise self._gone(f"what it sends is no Modbus TCP ({bytes(buffer[:8]).hex(' ')})")
            if len(buffer) < _HEADER + length:
                return None
            frame = bytes(buffer[: _HEADER + length])
            del buffer[: len(frame)]
            pdu = self._decoded(frame)
            if pdu is not None:
                return pdu
        return None

    def _decoded(self, frame: bytes) -> ModbusPDU | None:
        request = self._request
        if request is None or int.from_bytes(frame[:2], "big") != request.transaction_id:
            self.strays += 1
            return None
        try:
            _, pdu = self._framer.handleFrame(frame, self._unit, request.transaction_id)
        except ModbusException:
            pdu = None
        if pdu is None or not belongs(pdu, request):
            self.damaged += 1
            return None
        return pdu

    def _gone(self, reason: object) -> WireError:
        return WireError(
            f"{self.name} is gone: {reason}. Check its supply and the network; some drives take "
            "one connection only."
        )


def _connect(line: TcpLine, name: str) -> socket.socket:
    try:
        connection = socket.create_connection((line.host, line.port), line.connect_timeout_s)
    except (OSError, UnicodeError) as error:
        raise WireError(
            f"{name} cannot be reached: {error}. Check its supply, the network, and bus.host and "
            "bus.port; without hardware start the software rig."
        ) from error
    # Nagle's algorithm would hold a request back until the answer before it is acknowledged: 40 ms
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setblocking(False)
    return connection
