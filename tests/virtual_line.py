"""Serial lines and Modbus TCP in virtual time: bytes take what they take on a line, nobody waits.

The master's end is a socket of a pair behind `serial.Serial` and the Modbus driver's connect; its
reads and writes are real, only waiting for bytes lets the world's time pass instead of the host's.
The far ends are the rig's own drive, counter box, and faults; their timing is that of
`sim_rig.modbus.line` and `sim_rig.counter.line`.
"""

import errno
import select
import socket
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any, cast

import serial
from pymodbus.datastore import ModbusServerContext
from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU

import drivers.counter.counter
import drivers.modbus.rtu
import drivers.modbus.tcp
import drivers.serial_port
from drivers.clock import Clock
from drivers.errors import WireError
from drivers.modbus.lines import TcpLine
from drivers.modbus.link import readable
from sim_rig.counter.box import CounterBox
from sim_rig.counter.settings import CounterSettings
from sim_rig.modbus.drive import ModbusDrive
from sim_rig.modbus.line import Timing
from tests.virtual_world import VirtualEnd, VirtualWorld

PREFIX = "virtual:"
TCP_NS = 60_000
"""A request's way over the network, and the answer's way back."""
_LINES: dict[str, "VirtualLine"] = {}
_DESCRIPTORS: dict[int, "VirtualLine"] = {}
_real_connect = drivers.modbus.tcp._connect


class Port:
    """The master's end: what pyserial and a socket have in common, and `send`, `recv`."""

    def __init__(self, name: str, *_: Any, **__: Any) -> None:
        self._socket, self._descriptor = _LINES[name].connect()
        self.fileno, self.send, self.recv = (
            self._socket.fileno,
            self._socket.send,
            self._socket.recv,
        )

    def set_low_latency_mode(self, _on: bool) -> None:
        """As on a pty: there is none."""
        raise NotImplementedError

    def close(self) -> None:
        """Let go."""
        _DESCRIPTORS.pop(self._descriptor, None)
        self._socket.close()


class VirtualLine(VirtualEnd):
    """A line of a world, and the device at its far end."""

    def __init__(self, world: VirtualWorld, name: str) -> None:
        super().__init__()
        self.world = world
        self.name = PREFIX + name
        self.is_cut = False
        self._near: socket.socket | None = None
        _LINES[self.name] = self
        world.lines.append(self)

    def close(self) -> None:
        """Hang up, for good."""
        self.is_cut = True
        if self._near is not None:
            self._near.close()
            self._near = None
        _LINES.pop(self.name, None)

    def cut(self) -> None:
        """The cable is pulled: the device is gone, and cannot be opened again."""
        if self._near is not None:
            self._near.close()
            self._near = None
        self.is_cut = True

    def connect(self) -> tuple[socket.socket, int]:
        """A master's new end. OSError where the line is cut."""
        if self.is_cut:
            raise OSError(errno.ENOENT, "No such file or directory")
        if self._near is not None:
            self._near.close()
        self._near, far = socket.socketpair()
        self._near.setblocking(False)
        far.setblocking(False)
        _DESCRIPTORS[far.fileno()] = self
        return far, far.fileno()

    def wait(self, descriptor: int, until_ns: int) -> bool:
        """Let time pass until bytes are there for the master, or until then."""

        def some() -> bool:
            return bool(select.select([descriptor], [], [], 0.0)[0])

        self.world.pass_until(until_ns, some)
        return some()

    def hear(self) -> None:
        while self._near is not None:
            try:
                data = self._near.recv(4096)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self._near.close()
                self._near = None
                return
            self.received(data)

    def received(self, data: bytes) -> None:
        """Bytes from the master, written just now."""
        raise NotImplementedError

    def hand_over(self, data: bytes) -> None:
        """Bytes to the master."""
        if self._near is not None:
            with suppress(OSError):
                self._near.send(data)


class _ModbusEnd(VirtualLine):
    def __init__(self, world: VirtualWorld, name: str, drive: ModbusDrive) -> None:
        super().__init__(world, name)
        self._drive = drive
        self._buffer = bytearray()

    def _answer(self, request: ModbusPDU) -> ModbusPDU:
        """As pymodbus's server; the drive's registers wait for nothing."""
        context = cast(ModbusServerContext, self._drive)
        try:
            request.datastore_update(context, self._drive.unit).send(None)
        except StopIteration as done:
            answer: ModbusPDU = done.value
        except ModbusException:
            answer = ExceptionResponse(request.function_code, 1)
        else:
            raise AssertionError("the drive's registers waited")
        answer.dev_id, answer.transaction_id = self._drive.unit, request.transaction_id
        return answer


class RtuEnd(_ModbusEnd):
    """The rig's drive on RTU."""

    def __init__(self, world: VirtualWorld, name: str, drive: ModbusDrive, timing: Timing) -> None:
        super().__init__(world, name, drive)
        self._timing = timing
        self._framer = FramerRTU(DecodePDU(is_server=True))
        self._last_byte_ns = 0.0
        self._heard = 0

    def received(self, data: bytes) -> None:
        begin_ns = max(self.world.now_ns, self._last_byte_ns)
        self._last_byte_ns = begin_ns + len(data) * self._timing.character_s * 1e9
        self._buffer += data
        self._heard += 1
        heard = self._heard
        self.at(self._last_byte_ns + self._timing.t35_s * 1e9, lambda: self._frame_ended(heard))

    def _frame_ended(self, heard: int) -> None:
        if heard != self._heard:
            return
        frame = bytes(self._buffer)
        self._buffer.clear()
        try:
            _, request = self._framer.handleFrame(frame, self._drive.unit, 0)
        except ModbusException:
            return
        if request is None:
            return
        self._drive.request_arrived(int(self._last_byte_ns / 1000))
        answer = self._drive.outgoing(self._framer.buildFrame(self._answer(request)))
        if self._drive.outgoing.unplugged:
            self.cut()
        if answer:
            timing = self._timing
            takes_s = timing.t35_s + timing.turnaround_s + len(answer) * timing.character_s
            self.at(self._last_byte_ns + takes_s * 1e9, lambda: self.hand_over(answer))


class TcpEnd(_ModbusEnd):
    """The rig's drive on Modbus TCP."""

    def __init__(self, world: VirtualWorld, name: str, drive: ModbusDrive) -> None:
        super().__init__(world, name, drive)
        self._framer = FramerSocket(DecodePDU(is_server=True))

    def received(self, data: bytes) -> None:
        self.at(self.world.now_ns + TCP_NS, lambda: self._arrived(data))

    def _arrived(self, data: bytes) -> None:
        if self._drive.outgoing.unplugged:
            return
        self._buffer += data
        while len(self._buffer) >= 6:
            length = 6 + int.from_bytes(self._buffer[4:6], "big")
            frame = bytes(self._buffer[:length])
            del self._buffer[:length]
            self._drive.request_arrived(self.world.now_ns // 1000)
            _, request = self._framer.handleFrame(frame, 0, 0)
            if request is not None:
                answer = self._drive.outgoing(self._framer.buildFrame(self._answer(request)))
                self.at(self.world.now_ns + TCP_NS, lambda it=answer: self.hand_over(it))  # type: ignore[misc]


class CounterEnd(VirtualLine):
    """The rig's counter box."""

    def __init__(
        self, world: VirtualWorld, name: str, box: CounterBox, settings: CounterSettings
    ) -> None:
        super().__init__(world, name)
        self._box = box
        self._character_ns = settings.character_s * 1e9
        answer_s = box.framing.answer_bytes * settings.character_s
        self._takes_ns = (settings.turnaround_s + answer_s) * 1e9
        self._received = bytearray()
        self._last_byte_ns = self._free_ns = 0.0

    def received(self, data: bytes) -> None:
        self._last_byte_ns = max(self.world.now_ns, self._last_byte_ns)
        for byte in data:
            self._last_byte_ns += self._character_ns
            self._received.append(byte)
            number = self._box.framing.request(self._received)
            if number is not None:
                self._received.clear()
                self.at(
                    self._last_byte_ns + self._takes_ns,
                    self._answering(number, self._last_byte_ns),
                )

    def _answering(self, number: int, arrived_ns: float) -> Callable[[], None]:
        def answer() -> None:
            if self.is_cut:
                return
            answer = self._box.answer(number, int(arrived_ns / 1000))
            if answer.cut:
                self.cut()
            elif answer.data:
                done_ns = arrived_ns + self._takes_ns + answer.delay_s * 1e9
                on_the_line_ns = len(answer.data) * self._character_ns
                self._free_ns = max(done_ns, self._free_ns + on_the_line_ns)
                self.at(self._free_ns, lambda: self.hand_over(answer.data))

        return answer


def _serial(device: str, *arguments: Any, **named: Any) -> Any:
    virtual = isinstance(device, str) and device.startswith(PREFIX)
    return (Port if virtual else serial.Serial)(device, *arguments, **named)


def _connect(line: TcpLine, name: str) -> Any:
    if not line.host.startswith(PREFIX):
        return _real_connect(line, name)
    try:
        return Port(line.host)
    except OSError as error:
        raise WireError(f"{name} cannot be reached: {error}.") from error


def _readable(descriptor: int, until_ns: int, clock: Clock) -> bool:
    line = _DESCRIPTORS.get(descriptor)
    if line is None:
        return readable(descriptor, until_ns, clock)
    return line.wait(descriptor, until_ns)


def install_lines() -> None:
    """Make the drivers know devices and hosts whose name begins with PREFIX."""
    drivers.serial_port.serial = SimpleNamespace(Serial=_serial)  # type: ignore[attr-defined]
    drivers.modbus.tcp._connect = _connect
    for module in (drivers.modbus.rtu, drivers.modbus.tcp, drivers.counter.counter):
        module.readable = _readable  # type: ignore[attr-defined]
