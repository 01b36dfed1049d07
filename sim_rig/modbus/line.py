"""The rig's registers over Modbus RTU on a pty whose bytes take their time.

A pty hands bytes over at once. Here they count as arrived one character time after the other,
a frame ends when the line has been silent for t3.5, the drive takes its turnaround, and the answer
is handed over when its last byte would have arrived:

    arrival of the last byte = max(now, line free) + n · t_char        (the rig's time of a request)
    answer complete          = that + t3.5 + turnaround + m · t_char

Frames with a wrong check sum, of another unit, or cut off are passed over in silence, as on a real
line.
"""

import asyncio
import os
import time
import tty
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import cast

from pymodbus.datastore import ModbusServerContext
from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU

from sim_rig.errors import RigSettingsError
from sim_rig.modbus.drive import ModbusDrive
from sim_rig.settings import BusOptions

_LONGEST = 256
_T35_ABOVE_19200_S = 1.75e-3


@dataclass(frozen=True, slots=True)
class Timing:
    """How long bytes and the drive take."""

    character_s: float
    t35_s: float
    turnaround_s: float

    @classmethod
    def of(cls, bus: BusOptions) -> "Timing":
        """From baud_rate, parity, stop_bits, and turnaround_s. RigSettingsError for nonsense."""
        try:
            baud_rate = int(bus.get("baud_rate", 115200))
            bits = 9 + (bus.get("parity", "N") != "N") + int(bus.get("stop_bits", 2))
            turnaround_s = float(bus.get("turnaround_s", 0.0005))
        except ValueError as error:
            raise RigSettingsError(f"the rig's line {dict(bus)} cannot be: {error}.") from error
        if baud_rate < 300 or not 0.0 <= turnaround_s <= 1.0:
            raise RigSettingsError(
                f"baud_rate = {baud_rate}, turnaround_s = {turnaround_s}: a line has 300 Bd or "
                "more, and a turnaround of 0 to 1 s."
            )
        character_s = bits / baud_rate
        return cls(
            character_s,
            _T35_ABOVE_19200_S if baud_rate > 19200 else 3.5 * character_s,
            turnaround_s,
        )


class PtyLine:
    """One drive at the far end of a pty."""

    def __init__(self, drive: ModbusDrive, timing: Timing) -> None:
        self._drive = drive
        self._timing = timing
        self._loop = asyncio.get_running_loop()
        self._framer = FramerRTU(DecodePDU(is_server=True))
        self._near, self._far = os.openpty()
        tty.setraw(self._far)  # held open: else the rig would hang up when a master closes
        os.set_blocking(self._near, False)
        self.device = os.ttyname(self._far)
        self._buffer = bytearray()
        self._last_byte_s = 0.0
        self._is_cut = False
        self._end: asyncio.TimerHandle | None = None
        self._loop.add_reader(self._near, self._read)

    def close(self) -> None:
        """Hang up."""
        if self._is_cut:
            return
        self._is_cut = True
        self._loop.remove_reader(self._near)
        if self._end is not None:
            self._end.cancel()
        os.close(self._near)
        os.close(self._far)

    def _read(self) -> None:
        data = os.read(self._near, 4096)
        begin_s = max(time.monotonic(), self._last_byte_s)
        self._last_byte_s = begin_s + len(data) * self._timing.character_s
        self._buffer += data
        del self._buffer[: -2 * _LONGEST]
        if self._end is not None:
            self._end.cancel()
        self._end = self._loop.call_at(self._last_byte_s + self._timing.t35_s, self._frame_ended)

    def _frame_ended(self) -> None:
        frame = bytes(self._buffer)
        self._buffer.clear()
        try:
            _, request = self._framer.handleFrame(frame, self._drive.unit, 0)
        except ModbusException:
            return
        if request is not None:
            self._drive.request_arrived(int(self._last_byte_s * 1e6))
            self._loop.create_task(self._answer(request))

    async def _answer(self, request: ModbusPDU) -> None:
        try:
            answer = await request.datastore_update(
                cast(ModbusServerContext, self._drive), self._drive.unit
            )
        except ModbusException:
            answer = ExceptionResponse(request.function_code, 1)
        answer.dev_id = self._drive.unit
        frame = self._drive.outgoing(self._framer.buildFrame(answer))
        if self._drive.outgoing.unplugged:
            self.close()
        if not frame or self._is_cut:
            return
        timing = self._timing
        done_s = timing.t35_s + timing.turnaround_s + len(frame) * timing.character_s
        self._loop.call_at(self._last_byte_s + done_s, self._hand_over, frame)

    def _hand_over(self, frame: bytes) -> None:
        if not self._is_cut:
            os.write(self._near, frame)


@asynccontextmanager
async def listening(drive: ModbusDrive, bus: BusOptions) -> AsyncIterator[dict[str, str]]:
    """Be at the far end of a new pty; yields its device."""
    line = PtyLine(drive, Timing.of(bus))
    try:
        yield {"device": line.device}
    finally:
        line.close()
