"""Modbus RTU: an answer carries no number, so time and length must say to what it belongs.

1.  One request at a time, and none before the line has been silent for t3.5 (or the drive's own
    silent interval) since the last byte.
2.  What has come before a request is sent is thrown away.
3.  A request is given up only when the drive's longest response time has passed; its caller waits
    that long (`drivers.modbus.budget.response_timeout_s`), so no answer to it is on its way then.
4.  A drive that breaks even that is caught where its profile has spare words: after a lost answer
    the next requests ask for another length, and an answer of the old one does not fit.

Bytes that fit nothing are skipped one by one until a frame with the right unit, function, length,
and check sum begins: noise before an answer does not cost it.
"""

import os
import termios
from contextlib import suppress

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU, ModbusPDU

from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.errors import WireError
from drivers.modbus.frames import EXCEPTION_BYTES, answer_bytes, belongs, words_asked
from drivers.modbus.lines import RtuLine
from drivers.modbus.link import Reply, readable
from drivers.serial_port import open_port, read_now

_LONGEST = 256
_HEAD = 3
_BABBLE_NS = 250_000_000


class RtuLink:
    """A serial line to one drive; see `drivers.modbus.link`. WireError where it cannot open."""

    def __init__(
        self,
        line: RtuLine,
        unit: int,
        silent_interval_s: float = 0.0,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self.name = f"drive {unit} on {line.name}"
        self.strays = 0
        self.damaged = 0
        self._unit = unit
        self._clock = clock
        self._character_ns = line.character_s * 1e9
        self._silence_ns = round(max(line.t35_s, silent_interval_s) * 1e9)
        self._framer = FramerRTU(DecodePDU(is_server=False))
        self._buffer = bytearray()
        self._request: ModbusPDU | None = None
        self._busy_until_ns = clock.now_ns()  # when the last byte has left, or has come
        self._port = open_port(
            line.device, line.baud_rate, parity=line.parity, stop_bits=line.stop_bits
        )

    def begin(self, request: ModbusPDU) -> int:
        """Send a request after the line's silence; see `Link.begin`."""
        request.dev_id = self._unit
        frame = self._framer.buildFrame(request)
        self._fall_silent()
        self._request = request
        sent_ns = self._clock.now_ns()
        try:
            taken = os.write(self._port.fileno(), frame)
        except OSError as error:
            raise self._gone(error) from error
        if taken != len(frame):
            raise self._gone("it takes no more bytes")
        self._busy_until_ns = sent_ns + round(len(frame) * self._character_ns)
        return sent_ns

    def poll(self, until_ns: int) -> Reply | None:
        """The answer to the open request; see `Link.poll`."""
        while True:
            pdu = self._next_answer()
            if pdu is not None:
                self._request = None
                return Reply(pdu, self._busy_until_ns)
            if not readable(self._port.fileno(), until_ns, self._clock):
                return None
            self._read()

    def abandon(self) -> None:
        """Give the open request up, and what has come of its answer."""
        self._request = None
        self._buffer.clear()

    def close(self) -> None:
        """Close the device."""
        with suppress(OSError, termios.error):
            self._port.close()

    def _fall_silent(self) -> None:
        """Wait until the line has been silent for long enough; drop what came meanwhile."""
        give_up_ns = self._clock.now_ns() + self._silence_ns + _BABBLE_NS
        while self._clock.now_ns() < give_up_ns:
            silent_ns = self._busy_until_ns + self._silence_ns
            while readable(self._port.fileno(), self._clock.now_ns(), self._clock):
                self._read()
            if self._buffer:
                self.strays += 1
                self._buffer.clear()
                continue
            if self._clock.now_ns() >= silent_ns:
                return
            self._clock.sleep_until(silent_ns)
        raise self._gone("the line is never silent: somebody else talks on it")

    def _read(self) -> None:
        data = read_now(self._port, _LONGEST, self._gone)
        if not data:
            return
        self._busy_until_ns = self._clock.now_ns()
        self._buffer += data
        del self._buffer[: -2 * _LONGEST]

    def _next_answer(self) -> ModbusPDU | None:
        """The answer in the buffer, if it is whole; bytes before it are skipped."""
        request, buffer = self._request, self._buffer
        if request is None:
            return None
        while len(buffer) >= _HEAD:
            length = self._length(request)
            if length is None:
                del buffer[0]
                continue
            if len(buffer) < length:
                return None
            pdu = self._decoded(bytes(buffer[:length]))
            if pdu is not None and belongs(pdu, request):
                buffer.clear()
                return pdu
            self.damaged += 1
            del buffer[0]
        return None

    def _length(self, request: ModbusPDU) -> int | None:
        """How long the frame at the head of the buffer is, if it can be the answer at all."""
        unit, function, count = self._buffer[:_HEAD]
        if unit != self._unit or function & 0x7F != request.function_code:
            return None
        if function & 0x80:
            return EXCEPTION_BYTES
        words = words_asked(request)
        if words is not None and count != 2 * words:
            return None
        return answer_bytes(request)

    def _decoded(self, frame: bytes) -> ModbusPDU | None:
        try:
            _, pdu = self._framer.handleFrame(frame, self._unit, 0)
        except ModbusException:
            return None
        return pdu

    def _gone(self, reason: object) -> WireError:
        return WireError(f"{self.name} is gone: {reason}. Check the adapter and the cable.")
