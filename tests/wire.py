"""A software rig for tests, and a plain master: a stranger with python-can and the standards.

`local_rig` runs the slaves in the test itself, on a clock that the test winds; `spawned` is the
real thing, processes and frames between them. Nothing here knows the bench's own drivers.
"""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Any, Self

import can

from sim_rig.canopen.rig import SYNC, Rig
from sim_rig.model import Model
from sim_rig.plant import Plant
from sim_rig.process import SpawnedRig, spawn
from sim_rig.settings import Nominal, RigSettings

DRIVE, ENCODER, MASTER = 1, 2, 127
RPDO, DRIVE_STATE, DRIVE_MOTION = 0x200 + DRIVE, 0x180 + DRIVE, 0x280 + DRIVE
LOAD = 0x280 + ENCODER
COUNTS = 65536
STATE_MASK = 0x6F
PERIOD_US = 8000

NOMINAL = Nominal(
    torque_constant_nm_per_a=0.03606,
    inertia_kg_m2=0.00025,
    proportional_gain_a_s_per_rad=0.3466,
    integral_gain_a_per_rad=27.08,
    backlash_gap_rad=0.0262,
)
"""wn = 62.5 rad/s, zeta = 0.4, a gap of 1.5 degrees."""

SETTINGS = RigSettings(
    nominal=NOMINAL,
    bus={"interface": "socketcand", "host": "127.0.0.1", "port": 0, "channel": "can0"},
    drive_node_id=DRIVE,
    motor_counts_per_revolution=COUNTS,
    encoder_node_id=ENCODER,
    load_counts_per_revolution=COUNTS,
)


@contextmanager
def spawned(**changes: Any) -> Iterator[SpawnedRig]:
    """A rig in its own processes on a free port; `changes` are fields of RigSettings."""
    with spawn(replace(SETTINGS, **changes)) as rig:
        yield rig


def sdo_request(index: int, subindex: int, value: int | None, size: int) -> bytes:
    """The eight bytes that read (value None) or write up to four bytes of an object."""
    if value is None:
        return struct.pack("<BHB4x", 0x40, index, subindex)
    data = (value & ((1 << 8 * size) - 1)).to_bytes(size, "little")
    return struct.pack("<BHB4s", 0x23 | (4 - size) << 2, index, subindex, data)


class SdoAbortError(Exception):
    """The device refused; `code` as in CiA 301 table 22."""

    def __init__(self, code: int) -> None:
        super().__init__(f"SDO abort 0x{code:08X}")
        self.code = code


def sdo_answer(data: bytes, signed: bool = False) -> int:
    """The value of an expedited answer, 0 for a confirmed write. Raises SdoAbortError."""
    command = data[0] & 0xE0
    if command == 0x80:
        raise SdoAbortError(int.from_bytes(data[4:8], "little"))
    if command == 0x60:
        return 0
    size = 4 - (data[0] >> 2 & 3)
    return int.from_bytes(data[4 : 4 + size], "little", signed=signed)


@dataclass
class LocalRig:
    """The rig without bus or process: `now_us` passes when the test says so."""

    plant: Plant
    settings: RigSettings = SETTINGS
    now_us: int = 1_700_000_000_000_000
    sent: list[tuple[int, bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rig = Rig(self.settings, self.plant, lambda i, d: self.sent.append((i, d)))
        self.rig.boot()

    def take(self, can_id: int) -> list[bytes]:
        """What it has sent under one identifier since the last look at anything."""
        found = [data for sent_id, data in self.sent if sent_id == can_id]
        self.sent.clear()
        return found

    def send(self, can_id: int, data: bytes = b"") -> None:
        """A frame from the master, now."""
        self.rig.receive(can_id, data, self.now_us)

    def wait(self, duration_us: int) -> None:
        """Time without frames: ticks wherever the rig wants them."""
        end_us = self.now_us + duration_us
        while self.now_us < end_us:
            self.now_us += max(1, min(self.rig.wait_us(self.now_us), end_us - self.now_us))
            self.rig.tick(self.now_us)

    def sdo(
        self, node: int, index: int, subindex: int = 0, value: int | None = None, size: int = 4
    ) -> int:
        """Read or write an object. Raises SdoAbortError."""
        self.sent.clear()
        self.send(0x600 + node, sdo_request(index, subindex, value, size))
        (answer,) = self.take(0x580 + node)
        return sdo_answer(answer)

    def cycle(self, controlword: int, velocity_increments_s: int = 0, us: int = PERIOD_US) -> int:
        """One period: RPDO, SYNC; then time passes. The statusword that the SYNC brought."""
        self.send(RPDO, struct.pack("<Hi", controlword, velocity_increments_s))
        self.sent.clear()
        self.send(SYNC)
        status: int = struct.unpack_from("<H", self.take(DRIVE_STATE)[0])[0]
        self.now_us += us
        return status

    def enable(self, mode: int = 9) -> None:
        """Operational, a mode, and up the state machine."""
        self.sdo(DRIVE, 0x6060, 0, mode, 1)
        self.send(0, bytes([1, 0]))
        for controlword in (0x06, 0x07, 0x0F, 0x0F):
            status = self.cycle(controlword)
        assert status & STATE_MASK == 0x27


def local_rig(plant: Plant | None = None, **changes: Any) -> LocalRig:
    """A rig in this process; `changes` are fields of RigSettings."""
    settings = replace(SETTINGS, **changes)
    return LocalRig(plant or Model(settings.nominal).plant(), settings)


class PlainMaster:
    """A master on a real bus, by hand. Every wait ends with the frame or with an AssertionError."""

    def __init__(self, bus_options: dict[str, Any], timeout_s: float = 5.0) -> None:
        self._timeout_s = timeout_s
        self.bus = can.Bus(**bus_options)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.bus.shutdown()

    def send(self, can_id: int, data: bytes = b"") -> None:
        """Put a frame on the bus."""
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def expect(self, can_id: int, first: bytes = b"") -> can.Message:
        """The next frame of that identifier whose data begins so; others are passed over."""
        while (message := self.bus.recv(self._timeout_s)) is not None:
            if message.arbitration_id == can_id and message.data.startswith(first):
                return message
        raise AssertionError(f"no frame 0x{can_id:03X} {first.hex()} in {self._timeout_s} s")

    def sdo(
        self, node: int, index: int, subindex: int = 0, value: int | None = None, size: int = 4
    ) -> int:
        """Read or write an object. Raises SdoAbortError."""
        self.send(0x600 + node, sdo_request(index, subindex, value, size))
        return sdo_answer(bytes(self.expect(0x580 + node).data))

    def start(self) -> None:
        """NMT start to every node."""
        self.send(0, bytes([1, 0]))

    def cycle(self, controlword: int, velocity_increments_s: int = 0) -> int:
        """RPDO and SYNC; the statusword that comes back, after the encoder has answered too."""
        self.send(RPDO, struct.pack("<Hi", controlword, velocity_increments_s))
        self.send(SYNC)
        (status,) = struct.unpack_from("<H", self.expect(DRIVE_STATE).data)
        self.expect(LOAD)
        return int(status)

    def cycle_until(self, controlword: int, state: int, velocity_increments_s: int = 0) -> None:
        """Cycles until the drive shows a state (masked statusword)."""
        for _ in range(10_000):
            if self.cycle(controlword, velocity_increments_s) & STATE_MASK == state:
                return
        raise AssertionError(f"state 0x{state:02X} did not come")

    def enable(self, mode: int = 9) -> None:
        """Operational, a mode, and up the state machine."""
        self.sdo(DRIVE, 0x6060, 0, mode, 1)
        self.start()
        for controlword, state in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
            self.cycle_until(controlword, state)
