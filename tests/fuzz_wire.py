"""Frames and registers for `tests.fuzz_targets`: bytes that anybody may send us, on every wire."""

import struct
from functools import cache
from typing import Any

import can
from hypothesis import strategies as st

from drivers.counter.profile import load_profile as counter_profile
from drivers.counter.profile import profile_names as counter_profiles
from drivers.errors import SettingsError
from drivers.modbus.frames import belongs, read_request
from drivers.modbus.library import load_profile, profile_names
from drivers.modbus.lines import RtuLine, TcpLine
from drivers.modbus.link import Link
from drivers.modbus.plan import plan_of
from drivers.modbus.profile import TARGET
from drivers.modbus.rtu import RtuLink
from drivers.modbus.tcp import TcpLink
from sim_rig.canopen.socketcand import LONGEST_MESSAGE, parse, take_messages
from sim_rig.counter.framings import FRAMINGS, State
from tests.fault_campaign import STANDSTILL_RAD_S, look_after, rig_config
from tests.modbus_peer import rtu_frame, tcp_frame
from tests.virtual_line import VirtualLine, install_lines
from tests.virtual_modbus import VirtualModbus
from tests.virtual_rig import WORLDS, VirtualRig, install
from tests.virtual_world import VirtualWorld
from tests.wire import DRIVE, ENCODER, RPDO, LocalRig, local_rig

BYTES = st.integers(0, 255)
FLIPS = st.lists(st.tuples(st.integers(0, 400), st.integers(1, 255)), max_size=3)


def flipped(data: bytes, flips: list[tuple[int, int]]) -> bytes:
    """Some bytes changed."""
    changed = bytearray(data)
    for place, mask in flips:
        if changed:
            changed[place % len(changed)] ^= mask
    return bytes(changed)


@cache
def prepared() -> None:
    """Virtual time, for whatever is played on a whole rig."""
    install()
    install_lines()


# socketcand

_WORDS = st.sampled_from([b"<", b">", b"send", b"open", b"can0", b"rawmode", b"echo", b"201", b"8"])
SOCKETCAND = st.binary(max_size=300) | st.lists(_WORDS | st.binary(max_size=9), max_size=14).map(
    b" ".join
)


def socketcand(data: bytes) -> None:
    """Cut into messages, each of which is understood or refused."""
    for message in [*take_messages(bytearray(data)), data]:
        assert len(message) <= LONGEST_MESSAGE or message is data
        parse(message)


# serial counters

_STATES = st.builds(
    State,
    position=st.integers(0, 0xFFFFFFFF),
    status=BYTES,
    index_number=BYTES,
    index=st.integers(0, 0xFFFFFFFF),
)
_SAID = st.builds(
    lambda name, number, state, flips: flipped(FRAMINGS[name].answer(number, state), flips),
    st.sampled_from(sorted(FRAMINGS)),
    BYTES,
    _STATES,
    FLIPS,
)
COUNTER = st.binary(max_size=80) | _SAID


@cache
def _counters() -> list[Any]:
    return [counter_profile(name) for name in counter_profiles()]


def counter(data: bytes) -> None:
    """Every shipped framing reads it, and the software counter takes it for a request or not."""
    for profile in _counters():
        profile.answers.decode(data)
    for framing in FRAMINGS.values():
        framing.request(bytearray(data))


# Modbus masters

_PDU = (
    st.binary(max_size=40)
    | st.builds(lambda body: bytes((3, len(body))) + body, st.binary(max_size=8))
    | st.builds(lambda function, code: bytes((function | 0x80, code)), BYTES, BYTES)
)
_TCP_FRAME = st.builds(
    lambda pdu, number, unit, flips: flipped(tcp_frame(pdu, number, unit), flips),
    *(_PDU, st.integers(0, 3), st.integers(0, 2), FLIPS),
)
_RTU_FRAME = st.builds(
    lambda pdu, unit, flips: flipped(rtu_frame(pdu, unit), flips), _PDU, st.integers(0, 2), FLIPS
)
TCP_ANSWERS = st.lists(_TCP_FRAME | st.binary(max_size=60), max_size=4)
RTU_ANSWERS = st.lists(_RTU_FRAME | st.binary(max_size=60), max_size=4)


class _Nothing(VirtualWorld):
    """A world in which only lines are."""

    powered = False
    velocity_rad_s = 0.0

    def rig_wait_us(self) -> int:
        return 10_000

    def rig_tick(self) -> None:
        pass


class _Says(VirtualLine):
    """Answers any request by what it was given, piece after piece."""

    def __init__(self, world: VirtualWorld, pieces: list[bytes]) -> None:
        super().__init__(world, "fuzz")
        self._pieces = pieces

    def received(self, data: bytes) -> None:
        for number, piece in enumerate(self._pieces):
            self.at(self.world.now_ns + number * 50_000, lambda it=piece: self.hand_over(it))  # type: ignore[misc]
        self._pieces = []


def _asked(link: Link, world: VirtualWorld) -> None:
    """Two requests; what is taken for an answer is one."""
    try:
        for address in (0x10, 0x20):
            request = read_request(3, address, 2)
            until_ns = link.begin(request) + 1_000_000
            reply = link.poll(until_ns)
            assert reply is None or belongs(reply.pdu, request)
            assert world.now_ns < until_ns + 1_000_000
            link.abandon()
    finally:
        link.close()


def tcp_answers(pieces: list[bytes]) -> None:
    """The master asks, and hears that."""
    prepared()
    world = _Nothing()
    line = _Says(world, pieces)
    try:
        _asked(TcpLink(TcpLine(line.name), 1, world.clock()), world)
    finally:
        line.close()


def rtu_answers(pieces: list[bytes]) -> None:
    """The master asks, and hears that."""
    prepared()
    world = _Nothing()
    line = _Says(world, pieces)
    try:
        _asked(RtuLink(RtuLine(line.name, 460800, "N", 2), 1, 0.0, world.clock()), world)
    finally:
        line.close()


# CANopen

_TO_SLAVES = st.sampled_from([0, 0x80, RPDO, 0x300 + DRIVE, 0x601, 0x602, 0x77F, 0x701])
TO_SLAVES = st.lists(st.tuples(_TO_SLAVES, st.binary(max_size=8)), max_size=25)
_TO_MASTER = st.sampled_from(
    [0x81, 0x82, 0x181, 0x281, 0x282, 0x581, 0x582, 0x701, 0x702, 0x80, 0x77F, 0x7FF]
)
TO_MASTER = st.lists(
    st.tuples(st.integers(0, 120), _TO_MASTER, st.binary(max_size=8), st.booleans()), max_size=12
)


def to_slaves(script: list[tuple[int, bytes]]) -> None:
    """Frames to both nodes; afterwards they still can be reset, and tell who they are."""
    prepared()
    rig: LocalRig = local_rig()
    for can_id, data in script:
        rig.send(can_id, data)
        rig.wait(1000)
    rig.send(0, bytes([129, 0]))
    assert rig.sdo(DRIVE, 0x1018, 2) == 402
    assert rig.sdo(ENCODER, 0x1018, 2) == 406


def to_master(script: list[tuple[int, int, bytes, bool]]) -> None:
    """Frames that no node has sent, at any of the master's receptions, set-up and stop included."""
    prepared()
    world = _Whispered("fuzz", script)
    try:
        with world.axis() as axis:
            for slot in range(6):
                axis.command(1.0, slot)
                axis.samples(world.now_ns + 7_000_000)
                axis.events()
                world.pass_until(world.now_ns + 500_000)
    finally:
        look_after(world)
        del WORLDS[world.name]
        assert not world.powered, "left by the master, and not stopped by its own watchdog"
        assert abs(world.velocity_rad_s) < STANDSTILL_RAD_S


class _Whispered(VirtualRig):
    def __init__(self, name: str, script: list[tuple[int, int, bytes, bool]]) -> None:
        super().__init__(name)
        self._script = sorted(script, key=lambda it: it[0])
        self._receptions = 0

    def receive(self, timeout_s: float) -> can.Message | None:
        self._receptions += 1
        if self._script and self._script[0][0] <= self._receptions:
            _, can_id, data, odd = self._script.pop(0)
            return can.Message(arbitration_id=can_id, data=data, is_extended_id=odd)
        return super().receive(timeout_s)


# registers

_REQUEST_PDU = (
    st.binary(max_size=30)
    | st.builds(
        lambda function, address, count: (
            bytes((function,)) + address.to_bytes(2, "big") + count.to_bytes(2, "big")
        ),
        *(st.sampled_from([3, 4, 6, 16, 23, 1, 43]), st.integers(0, 0x220), st.integers(0, 130)),
    )
    | st.builds(
        lambda address, words: (
            bytes((16,))
            + address.to_bytes(2, "big")
            + len(words).to_bytes(2, "big")
            + bytes((2 * len(words),))
            + b"".join(word.to_bytes(2, "big") for word in words)
        ),
        *(st.integers(0, 0x220), st.lists(st.integers(0, 0xFFFF), max_size=8)),
    )
)
REQUESTS = st.lists(st.tuples(st.booleans(), _REQUEST_PDU, FLIPS), max_size=8)


def requests(script: list[tuple[bool, bytes, list[tuple[int, int]]]]) -> None:
    """Requests to the rig's registers on RTU; afterwards it still answers a good one."""
    prepared()
    world = VirtualModbus("fuzz", rig_config("modbus-rtu"))
    end = world.line
    try:
        for framed, pdu, flips in script:
            end.received(rtu_frame(pdu) if framed else flipped(rtu_frame(pdu), flips))
            world.pass_until(world.now_ns + 5_000_000)
        heard: list[bytes] = []
        end.hand_over = heard.append
        end.received(rtu_frame(bytes((3, 0, 0, 0, 2))))
        world.pass_until(world.now_ns + 20_000_000)
        assert heard[-1:] == [rtu_frame(bytes((3, 4, 0x53, 0x42, 0x01, 0x92)))]
    finally:
        world.close()


WORDS = st.tuples(
    st.sampled_from(profile_names()),
    st.binary(min_size=64, max_size=64).map(lambda data: struct.unpack(">32H", data)),
    st.floats() | st.integers(),
    st.integers(0, 9),
)


@cache
def _plan(name: str) -> Any:
    return plan_of(load_profile(name))


def words(case: tuple[str, tuple[int, ...], float, int]) -> None:
    """Any registers are digits, any velocity is registers or is refused."""
    name, registers, velocity, lost = case
    profile, plan = load_profile_once(name), _plan(name)
    for exchange in plan.exchanges:
        if exchange.read is not None:
            exchange.read.decode(registers[: exchange.read.count])
    try:
        digits = dict.fromkeys(profile.items, 0) | dict(profile.cycle.values) | {TARGET: velocity}
        for exchange in plan.exchanges:
            exchange.request(digits, lost)
    except ValueError as error:
        raise SettingsError(str(error)) from error  # as the cycle does


@cache
def load_profile_once(name: str) -> Any:
    """A shipped profile."""
    return load_profile(name)
