"""A CANopen world in one thread, on a clock of its own: no sockets, no sleep, no chance.

`World` is bus and time: a frame that the master sends is answered before `send` returns, and time
passes only while the master waits. `FakeDrive` and `FakeEncoder` behave as CiA 301, 402, and 406
say, and misbehave as a test asks: `aborts`, `sticky`, `mute`, `drops`, `at_sync`.
"""

import struct
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import can
import pytest
from can.interfaces import BACKENDS

from drivers.canopen.master import CanopenAxis
from drivers.canopen.settings import (
    CanopenSettings,
    DriveSettings,
    EncoderSettings,
    NodeSettings,
)
from drivers.clock import Clock

U8, U16, U32, I8, I16, I32 = 0x05, 0x06, 0x07, 0x02, 0x03, 0x04
CODES = {U8: "<B", U16: "<H", U32: "<I", I8: "<b", I16: "<h", I32: "<i"}
WORLDS: dict[str, "World"] = {}


@dataclass
class Entry:
    """One object: type, value, whether it may be written over SDO, and mapped."""

    kind: int
    value: int
    writable: bool = True
    mappable: bool = False


class World:
    """The bus and its time; `sent` keeps (COB-ID, data) of everything the master sent."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.now_ns = 1_000_000_000
        self.nodes: list[FakeNode] = []
        self.waiting: deque[can.Message] = deque()
        self.sent: list[tuple[int, bytes]] = []
        self.syncs = 0
        self.dead = False
        self.closed = 0
        self.drops: Callable[[int], bool] = lambda cob_id: False
        self.at_sync: Callable[[int], None] = lambda count: None
        self.clock = Clock(self._look_at_clock, lambda seconds: self._pass(round(seconds * 1e9)))
        WORLDS[name] = self

    def _look_at_clock(self) -> int:
        self.now_ns += 200
        return self.now_ns

    def _pass(self, duration_ns: int) -> None:
        self._pass_until(self.now_ns + duration_ns, stop_on_frame=False)

    def _pass_until(self, end_ns: int, *, stop_on_frame: bool) -> None:
        while self.now_ns < end_ns:
            due = min((node.next_beat_ns() for node in self.nodes), default=end_ns)
            self.now_ns = max(self.now_ns, min(due, end_ns))
            for node in self.nodes:
                node.beat()
            if stop_on_frame and self.waiting:
                return

    def deliver(self, cob_id: int, data: bytes) -> None:
        """A node puts a frame on the bus."""
        if not self.drops(cob_id):
            self.waiting.append(can.Message(arbitration_id=cob_id, data=data, is_extended_id=False))

    def receive(self, timeout_s: float) -> can.Message | None:
        if self.dead:
            raise can.CanOperationError("server closed the connection")
        if not self.waiting:
            end_ns = self.now_ns + round(timeout_s * 1e9)
            self._pass_until(end_ns, stop_on_frame=True)
        return self.waiting.popleft() if self.waiting else None

    def take(self, cob_id: int, data: bytes) -> None:
        """The master puts a frame on the bus."""
        if self.dead:
            raise BrokenPipeError(32, "Broken pipe")
        self.sent.append((cob_id, data))
        if cob_id == 0x080:
            self.syncs += 1
            self.at_sync(self.syncs)
        for node in self.nodes:
            node.take(cob_id, data)


class FakeBus(can.BusABC):
    """python-can's side of a `World`; registered as interface "fake"."""

    def __init__(self, channel: str) -> None:
        self._world = WORLDS[channel]
        self.channel_info = f"fake bus {channel}"
        super().__init__(channel)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._world.take(msg.arbitration_id, bytes(msg.data))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        assert timeout is not None, "the master must never wait without end"
        return self._world.receive(timeout)

    def shutdown(self) -> None:
        self._world.closed += 1
        super().shutdown()
        if self._world.dead:  # python-can's slcan says "close" to the adapter
            raise can.CanOperationError("Could not write to serial device")


@dataclass
class FakeNode:
    """CiA 301: SDO (expedited), NMT, heartbeat, PDOs on SYNC as the mapping says."""

    world: World
    node_id: int
    objects: dict[tuple[int, int], Entry]
    state: int = 0x7F
    mute: bool = False
    aborts: dict[tuple[int, int], int] = field(default_factory=dict)
    sticky: set[tuple[int, int]] = field(default_factory=set)

    def __post_init__(self) -> None:
        self._beat_ns = self.world.now_ns
        self._pending: list[bytes] = []
        self.world.nodes.append(self)

    def __getitem__(self, key: tuple[int, int]) -> int:
        return self.objects[key].value

    def __setitem__(self, key: tuple[int, int], value: int) -> None:
        self.objects[key].value = value

    def next_beat_ns(self) -> int:
        period_ms = self.objects[0x1017, 0].value if (0x1017, 0) in self.objects else 0
        return self._beat_ns + period_ms * 1_000_000 if period_ms else 1 << 62

    def beat(self) -> None:
        if self.world.now_ns >= self.next_beat_ns():
            self._beat_ns = self.world.now_ns
            self.world.deliver(0x700 + self.node_id, bytes((self.state,)))

    def restart(self) -> None:
        """Boot up again, set-up forgotten."""
        self.state = 0x7F
        self.world.deliver(0x700 + self.node_id, b"\0")

    def take(self, cob_id: int, data: bytes) -> None:
        if cob_id == 0 and data[1] in (0, self.node_id):
            self.state = {1: 5, 2: 4, 0x80: 0x7F}[data[0]]
            self.world.deliver(0x700 + self.node_id, bytes((self.state,)))
        elif cob_id == 0x600 + self.node_id and not self.mute:
            self._answer_sdo(data)
        elif self.state == 5 and cob_id == 0x080:
            self.on_sync()
        elif self.state == 5 and (0x1400, 1) in self.objects and cob_id == self[0x1400, 1]:
            self._pending.append(data)

    def _answer_sdo(self, data: bytes) -> None:
        command, index, sub = struct.unpack_from("<BHB", data)
        entry = self.objects.get((index, sub))
        if command == 0x80:
            return
        if entry is None:
            self._abort(index, sub, 0x06020000)
        elif command == 0x40:
            value = struct.pack(CODES[entry.kind], entry.value)
            head = struct.pack("<BHB", 0x43 | (4 - len(value)) << 2, index, sub)
            self.world.deliver(0x580 + self.node_id, head + value.ljust(4, b"\0"))
        elif (index, sub) in self.aborts:
            self._abort(index, sub, self.aborts[index, sub])
        elif not entry.writable:
            self._abort(index, sub, 0x06010002)
        else:
            value = struct.unpack_from(CODES[entry.kind], data, 4)[0]
            if (index, sub) not in self.sticky:
                entry.value = value
            self.on_write(index, sub, value)
            self.world.deliver(0x580 + self.node_id, struct.pack("<BHBI", 0x60, index, sub, 0))

    def _abort(self, index: int, sub: int, code: int) -> None:
        self.world.deliver(0x580 + self.node_id, struct.pack("<BHBI", 0x80, index, sub, code))

    def on_write(self, index: int, sub: int, value: int) -> None:
        """A write over SDO was taken."""

    def on_sync(self) -> None:
        self.sample()
        for number in range(3):
            cob_id = self.objects.get((0x1800 + number, 1))
            if cob_id is not None and not cob_id.value >> 31:
                self.world.deliver(cob_id.value & 0x7FF, self._packed(0x1A00 + number))
        for data in self._pending:
            self._unpack(0x1600, data)
        self._pending.clear()
        self.act()

    def sample(self) -> None:
        """Take the sample that this SYNC asks for."""

    def act(self) -> None:
        """Let the command of this SYNC act."""

    def _mapped(self, mapping: int) -> list[Entry]:
        keys = [self.objects[mapping, n].value for n in range(1, self[mapping, 0] + 1)]
        return [self.objects[key >> 16, key >> 8 & 0xFF] for key in keys]

    def _packed(self, mapping: int) -> bytes:
        return b"".join(struct.pack(CODES[e.kind], e.value) for e in self._mapped(mapping))

    def _unpack(self, mapping: int, data: bytes) -> None:
        offset = 0
        for entry in self._mapped(mapping):
            entry.value = struct.unpack_from(CODES[entry.kind], data, offset)[0]
            offset += struct.calcsize(CODES[entry.kind])

    def emergency(self, code: int) -> None:
        """Send an emergency."""
        self.world.deliver(0x80 + self.node_id, struct.pack("<HB5x", code, 1))

    def eds(self, folder: Path, name: str, without: tuple[int, ...] = ()) -> Path:
        """Write an EDS that describes this node, some objects left out."""
        lines = []
        for index in sorted({i for i, _ in self.objects} - set(without)):
            subs = sorted(s for i, s in self.objects if i == index)
            if subs == [0]:
                lines += [f"[{index:04X}]", "ObjectType=0x7", *self._eds(index, 0)]
            else:
                lines += [f"[{index:04X}]", f"ParameterName=Object {index:04X}", "ObjectType=0x9"]
                for sub in subs:
                    lines += [f"[{index:04X}sub{sub:X}]", *self._eds(index, sub)]
        path = folder / name
        path.write_text("\n".join(lines) + "\n", "ascii")
        return path

    def _eds(self, index: int, sub: int) -> list[str]:
        entry = self.objects[index, sub]
        return [
            f"ParameterName=Object {index:04X} {sub}",
            f"DataType=0x{entry.kind:04X}",
            f"AccessType={'rw' if entry.writable else 'ro'}",
            f"PDOMapping={int(entry.mappable)}",
        ]


def _pdo(base: int, cob_id: int) -> dict[tuple[int, int], Entry]:
    objects = {(base, 1): Entry(U32, cob_id), (base, 2): Entry(U8, 255), (base, 5): Entry(U16, 0)}
    objects[base + 0x200, 0] = Entry(U8, 0)
    return objects | {(base + 0x200, sub): Entry(U32, 0) for sub in range(1, 5)}


@dataclass
class FakeDrive(FakeNode):
    """CiA 402: state machine, CSV, an ideal motor; `fault` latches until reset (or for good)."""

    fault: int = 0
    stuck_fault: bool = False
    dc_link: bool = True
    follows: bool = True
    stays_in_quick_stop: bool = False
    turns_in_quick_stop: bool = False
    coasts: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self._reset_bit = False
        self._sampled_ns = self.world.now_ns
        self._position = 0.0
        self[0x6041, 0] = 0x0208 if self.fault else 0x0240

    @property
    def enabled(self) -> bool:
        return self[0x6041, 0] & 0x6F == 0x27

    def trip(self, code: int) -> None:
        """Fall into fault and say so."""
        self.fault = self[0x603F, 0] = code
        self.emergency(code)
        self._set_state(0x08)

    def restart(self) -> None:
        self._set_state(0x40)
        self[0x60FF, 0] = 0
        super().restart()

    def on_write(self, index: int, sub: int, value: int) -> None:
        if index == 0x6060:
            self[0x6061, 0] = value
        if index == 0x6040:
            self._transition(value)

    def sample(self) -> None:
        elapsed_s = (self.world.now_ns - self._sampled_ns) * 1e-9
        self._sampled_ns = self.world.now_ns
        stopping = self.turns_in_quick_stop and self[0x6041, 0] & 0x6F == 0x07
        if self.enabled and self.follows:
            self[0x606C, 0] = self[0x60FF, 0]
        elif not (stopping or self.coasts):
            self[0x606C, 0] = 0
        self._position += self[0x606C, 0] * elapsed_s
        self[0x6064, 0] = (round(self._position) + (1 << 31)) % (1 << 32) - (1 << 31)
        if (0x1013, 0) in self.objects:
            self[0x1013, 0] = self.world.now_ns // 1000 % (1 << 32)

    def act(self) -> None:
        self._transition(self[0x6040, 0])

    def _transition(self, controlword: int) -> None:
        status = self[0x6041, 0]
        edge = bool(controlword & 0x80) and not self._reset_bit
        self._reset_bit = bool(controlword & 0x80)
        if status & 0x4F == 0x08:
            if edge and not self.stuck_fault:
                self.fault = self[0x603F, 0] = 0
                self._set_state(0x40)
        elif controlword & 0x06 == 0x02 and self.stays_in_quick_stop:
            self._set_state(0x07)
        elif controlword & 0x02 == 0 or controlword & 0x07 == 0x02:
            self._set_state(0x40)  # disable voltage; quick stop (0x605A = 2) of an ideal motor
        elif controlword & 0x07 == 0x06:
            self._set_state(0x21)
        elif controlword & 0x0F == 0x0F and status & 0x6F in (0x23, 0x27) and self.dc_link:
            self._set_state(0x27)
        elif controlword & 0x07 == 0x07 and status & 0x6F in (0x21, 0x27):
            self._set_state(0x23)

    def _set_state(self, bits: int) -> None:
        follows = 0x1000 if bits == 0x27 and self.follows else 0
        self[0x6041, 0] = 0x0200 | bits | follows | (0x10 if self.dc_link else 0)


@dataclass
class FakeEncoder(FakeNode):
    """CiA 406: counts on by `step` at every SYNC, wraps at 0x6002."""

    step: int = 7

    def sample(self) -> None:
        self[0x6004, 0] = (self[0x6004, 0] + self.step) % self[0x6002, 0]


def drive_objects(node_id: int) -> dict[tuple[int, int], Entry]:
    """The objects of the wire contract's drive."""
    return {
        (0x1005, 0): Entry(U32, 0x80),
        (0x1006, 0): Entry(U32, 0),
        (0x1013, 0): Entry(U32, 0, writable=False, mappable=True),
        (0x1016, 1): Entry(U32, 0),
        (0x1017, 0): Entry(U16, 0),
        (0x1018, 1): Entry(U32, 0, writable=False),
        (0x1018, 2): Entry(U32, 402, writable=False),
        **_pdo(0x1400, 0x200 + node_id),
        **_pdo(0x1800, 0x40000180 + node_id),
        **_pdo(0x1801, 0x280 + node_id),
        **_pdo(0x1802, 0x380 + node_id),
        (0x6007, 0): Entry(I16, 1),
        (0x603F, 0): Entry(U16, 0, writable=False, mappable=True),
        (0x6040, 0): Entry(U16, 0, mappable=True),
        (0x6041, 0): Entry(U16, 0x0240, writable=False, mappable=True),
        (0x605A, 0): Entry(I16, 6),
        (0x6060, 0): Entry(I8, 0),
        (0x6061, 0): Entry(I8, 0, writable=False),
        (0x6064, 0): Entry(I32, 0, writable=False, mappable=True),
        (0x606C, 0): Entry(I32, 0, writable=False, mappable=True),
        (0x6076, 0): Entry(U32, 640, writable=False),
        (0x6077, 0): Entry(I16, 0, writable=False, mappable=True),
        (0x6083, 0): Entry(U32, 1000),
        (0x608F, 1): Entry(U32, 65536),
        (0x608F, 2): Entry(U32, 1),
        (0x6091, 1): Entry(U32, 1),
        (0x6091, 2): Entry(U32, 1),
        (0x60A9, 0): Entry(U32, 0x00B50300),
        (0x60C2, 1): Entry(U8, 1),
        (0x60C2, 2): Entry(I8, -2),
        (0x60FF, 0): Entry(I32, 0, mappable=True),
        (0x6502, 0): Entry(U32, 1 << 2 | 1 << 8, writable=False),
    }


def encoder_objects(node_id: int) -> dict[tuple[int, int], Entry]:
    """The objects of the wire contract's encoder."""
    return {
        (0x1005, 0): Entry(U32, 0x80),
        (0x1013, 0): Entry(U32, 0, writable=False, mappable=True),
        (0x1017, 0): Entry(U16, 0),
        (0x1018, 1): Entry(U32, 0, writable=False),
        (0x1018, 2): Entry(U32, 406, writable=False),
        **_pdo(0x1800, 0x180 + node_id),
        **_pdo(0x1801, 0x280 + node_id),
        (0x6001, 0): Entry(U32, 65536),
        (0x6002, 0): Entry(U32, 65536 * 4096),
        (0x6004, 0): Entry(U32, 65536 * 4096 - 100, writable=False, mappable=True),
    }


class FakeRig:
    """A drive and an encoder in a world of their own, and the settings that fit them."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(BACKENDS, "fake", (__name__, FakeBus.__name__))
        self.folder = folder
        self.world = World(str(folder))
        self.drive = FakeDrive(self.world, 1, drive_objects(1))
        self.encoder = FakeEncoder(self.world, 2, encoder_objects(2))

    def settings(
        self,
        *,
        period_s: float = 0.008,
        encoder: bool = True,
        without: tuple[int, ...] = (),
        node: Mapping[str, Any] = MappingProxyType({}),
        **drive: Any,
    ) -> CanopenSettings:
        """Settings of this rig; `node` and `drive` change single ones, `without` cuts the EDS."""
        drive_eds = self.drive.eds(self.folder, "drive.eds", without)
        drive_node = replace(NodeSettings(1, drive_eds, 0), **node)
        encoder_node = NodeSettings(2, self.encoder.eds(self.folder, "encoder.eds"), 0, 406)
        return CanopenSettings(
            bus={"interface": "fake", "channel": self.world.name},
            drive=replace(DriveSettings(drive_node, 65536), **drive),
            encoder=EncoderSettings(encoder_node, 65536) if encoder else None,
            period_s=period_s,
            stuck_travel_rad=10.0,  # its encoder counts on by itself, whatever the motor does
        )

    def axis(self, settings: CanopenSettings | None = None, **changes: Any) -> CanopenAxis:
        """A master for this rig."""
        return CanopenAxis(settings or self.settings(**changes), self.world.clock)

    def nothing_enabled(self) -> bool:
        """The drive is off, the bus is closed, and the last command was no velocity."""
        return not self.drive.enabled and self.world.closed == 1 and self.drive[0x60FF, 0] == 0
