"""The software rig on Modbus as strangers meet it: its registers, its clock, its own stop."""

import asyncio
import os
import select
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pymodbus.client import ModbusTcpClient

from sim_rig.errors import RigSettingsError, SimRigError
from sim_rig.modbus.drive import ModbusDrive
from sim_rig.modbus.line import Timing
from sim_rig.modbus.serve import serve
from sim_rig.modbus.table import TABLE, runs
from sim_rig.model import Model
from sim_rig.process import plant_of
from sim_rig.settings import RigSettings
from tests.modbus_peer import rtu_frame
from tests.wire import NOMINAL, SETTINGS

COUNTS = 65536
RAD = 2 * np.pi / COUNTS
TCP = replace(SETTINGS, protocol="modbus-tcp", bus={"host": "127.0.0.1", "port": 0})
LINE = {"baud_rate": 460800, "parity": "N", "stop_bits": 2, "turnaround_s": 0.0005}
RTU = replace(SETTINGS, protocol="modbus-rtu", bus=LINE)
STATUS, MASK = 0x0200, 0x6F


@contextmanager
def serving(settings: RigSettings) -> Iterator[dict[str, Any]]:
    """The rig in a thread of this process; where it is."""
    where: dict[str, Any] = {}
    up, over = threading.Event(), threading.Event()

    def ready(bus: dict[str, Any]) -> None:
        where.update(bus)
        up.set()

    plant = plant_of(settings)
    thread = threading.Thread(target=serve, args=(settings, plant, ready, over.is_set))
    thread.start()
    try:
        assert up.wait(10.0), "the rig did not come up"
        yield where
    finally:
        over.set()
        thread.join()


class Wound:
    """The drive without a wire, on a clock that the test winds."""

    def __init__(self, settings: RigSettings = TCP) -> None:
        self.drive = ModbusDrive(settings, plant_of(settings))
        self.now_us = 1_000_000

    def request(self, us: int = 0) -> None:
        self.now_us += us
        self.drive.request_arrived(self.now_us)

    def wait(self, us: int) -> None:
        end_us = self.now_us + us
        while self.now_us < end_us:
            self.now_us += max(1, min(self.drive.wait_us(self.now_us), end_us - self.now_us))
            self.drive.tick(self.now_us)

    def write(self, address: int, *words: int) -> None:
        self.request()
        assert self.drive.write(address, words) is None

    def control(self, controlword: int, velocity: int = 0, us: int = 0) -> int:
        self.request(us)
        words = [controlword, velocity >> 16 & 0xFFFF, velocity & 0xFFFF]
        assert self.drive.write(0x0100, words) is None
        return self.long(STATUS, 1)

    def long(self, address: int, words: int = 2) -> int:
        got = self.drive.read(address, words)
        assert isinstance(got, list)
        raw = b"".join(word.to_bytes(2, "big") for word in got)
        return int.from_bytes(raw, "big", signed=words == 2)

    def enable(self) -> None:
        for word in (0x06, 0x07, 0x0F):
            self.control(word)
        assert self.long(STATUS, 1) & MASK == 0x27


def test_the_registers_are_where_the_table_says_and_overlap_nowhere() -> None:
    taken = [register for entry in TABLE for register in range(entry.address, entry.end)]
    assert len(set(taken)) == len(taken)
    assert sorted(taken) == [a + k for a, n in runs() for k in range(n)]
    rig = Wound()
    assert rig.drive.read(0x0000, 2) == [0x5342, 402]
    assert rig.long(0x0012) == rig.long(0x0014) == COUNTS
    assert rig.long(0x0016) == 640
    assert rig.drive.read(0x020C, 4) == [350, 0, 0, 0]


def test_what_cannot_be_read_or_written_gets_the_exception_of_the_standard() -> None:
    rig = Wound()
    for address, count in ((0x0002, 1), (0x0200, 17), (0xFFFF, 1)):
        assert rig.drive.read(address, count) == 2
    assert rig.drive.write(0x0200, [1]) == 2, "read only"
    assert rig.drive.write(0x0101, [1]) == 3, "half a quantity"
    assert rig.drive.write(0x0102, [1]) == 2, "its other half"
    assert rig.drive.write(0x001A, [99]) == 3, "a value that the drive refuses"


def test_the_machine_lives_on_the_times_of_the_requests() -> None:
    """As the simulation has it, to half a count, whatever the intervals."""
    rig = Wound()
    rig.enable()
    random = np.random.default_rng(3)
    commands = random.choice([-30_000, 30_000], 80)
    durations_us = random.integers(4_000, 12_000, 80)
    motor, load, stamps = [], [], []
    for command, duration_us in zip(commands.tolist(), durations_us.tolist(), strict=True):
        rig.control(0x0F, command)
        rig.request(duration_us)
        motor.append(rig.long(0x0203))
        load.append(rig.long(0x0205))
        stamps.append(rig.long(0x0201))
    truth = Model(NOMINAL).simulate(commands * RAD, durations_us * 1e-6)
    assert np.abs(np.array(motor[:-1]) * RAD - truth.motor_angle_rad[1:]).max() <= 0.5001 * RAD
    assert np.abs(np.array(load[:-1]) * RAD - truth.load_angle_rad[1:]).max() <= 0.5001 * RAD
    assert np.diff(stamps).tolist() == durations_us[1:].tolist()


@pytest.mark.parametrize(("reaction", "ends"), [(1, 0x08), (3, 0x40), (0, 0x27)])
def test_without_requests_it_stops_by_itself(reaction: int, ends: int) -> None:
    rig = Wound()
    rig.write(0x0010, 100)
    rig.write(0x0011, reaction)
    rig.enable()
    for _ in range(20):
        rig.control(0x0F, 40_000, 8_000)
    assert rig.long(0x0207) > 30_000
    rig.wait(90_000)
    assert rig.long(STATUS, 1) & MASK == 0x27, "not yet"
    rig.wait(3_000_000)
    assert rig.long(STATUS, 1) & (0x4F if ends != 0x27 else MASK) == ends
    if ends == 0x27:
        return
    assert rig.long(0x0207) == 0
    before = rig.long(0x0203)
    rig.wait(100_000)
    assert rig.long(0x0203) == before
    assert rig.long(0x020B, 1) == (0x8130 if reaction == 1 else 0)


def test_any_request_keeps_it_going_and_zero_switches_the_timeout_off() -> None:
    rig = Wound()
    rig.write(0x0010, 100)
    rig.enable()
    for _ in range(10):
        rig.wait(90_000)
        rig.request()
    assert rig.long(STATUS, 1) & MASK == 0x27
    rig.write(0x0010, 0)
    rig.wait(5_000_000)
    assert rig.long(STATUS, 1) & MASK == 0x27


# over TCP: pymodbus's own client


@pytest.mark.wire
def test_pymodbus_reads_writes_and_does_both_at_once() -> None:
    with ExitStack() as stack:
        where = stack.enter_context(serving(TCP))
        client = ModbusTcpClient(where["host"], port=where["port"], timeout=5, retries=0)
        with client:
            assert client.read_holding_registers(0, count=2, device_id=1).registers == [0x5342, 402]
            assert client.read_input_registers(0, count=2, device_id=1).registers == [0x5342, 402]
            for word in (0x06, 0x07, 0x0F):
                assert not client.write_register(0x0100, word, device_id=1).isError()
            answer = client.readwrite_registers(
                read_address=STATUS,
                read_count=15,
                write_address=0x0100,
                values=[0x0F, 0, 20_000],
                device_id=1,
            )
            assert answer.registers[0] & MASK == 0x27, "the write came first"
            moved = 0
            while moved < 1000:
                got = client.read_holding_registers(0x0203, count=2, device_id=1).registers
                moved = client.convert_from_registers(got, client.DATATYPE.INT32)
            refused = client.write_register(STATUS, 1, device_id=1)
            assert refused.isError()
            assert refused.exception_code == 2
            assert client.read_holding_registers(0x0300, count=1, device_id=1).exception_code == 2


@pytest.mark.wire
def test_a_port_that_is_taken_is_said() -> None:
    with serving(TCP) as where, ExitStack() as inner:
        taken = replace(TCP, bus={"host": where["host"], "port": where["port"]})
        inner.enter_context(pytest.raises(SimRigError, match="the port is taken"))
        serve(taken, plant_of(TCP), lambda _: None, lambda: True)


def test_it_listens_on_loopback_only() -> None:
    bus = {"host": "0.0.0.0", "port": 0}  # noqa: S104 - that is what must not be
    with pytest.raises(RigSettingsError, match="listens on loopback only"):
        serve(replace(TCP, bus=bus), plant_of(TCP), lambda _: None, lambda: True)


# over a pty, by hand


def ask(device: int, frame: bytes, patience_s: float = 5.0) -> bytes:
    """Write a frame and take what comes until nothing comes for a while."""
    os.write(device, frame)
    got = b""
    while select.select([device], [], [], patience_s)[0]:
        got += os.read(device, 256)
        patience_s = 0.02
    return got


@pytest.mark.wire
def test_rtu_answers_its_unit_s_good_frames_and_passes_over_the_others() -> None:
    with serving(RTU) as where:
        device = os.open(where["device"], os.O_RDWR | os.O_NOCTTY)
        try:
            read = bytes([3, 0, 0, 0, 2])
            good = rtu_frame(bytes([3, 4, 0x53, 0x42, 0x01, 0x92]))
            assert ask(device, rtu_frame(read)) == good
            assert ask(device, rtu_frame(read, unit=2), 0.1) == b""
            assert ask(device, rtu_frame(read)[:-1] + b"\0", 0.1) == b""
            assert ask(device, rtu_frame(read)[:4], 0.1) == b"", "cut off"
            assert ask(device, rtu_frame(read)) == good, "and nothing of them is left"
            assert ask(device, rtu_frame(bytes([3, 3, 0, 0, 2]))) == rtu_frame(bytes([0x83, 2]))
        finally:
            os.close(device)


@pytest.mark.wire
def test_rtu_bytes_take_their_time() -> None:
    """No answer sooner than bytes, t3.5, and turnaround allow; 9600 Bd makes it long enough."""
    slow = replace(RTU, bus={**LINE, "baud_rate": 9600, "turnaround_s": 0.01})
    with serving(slow) as where:
        device = os.open(where["device"], os.O_RDWR | os.O_NOCTTY)
        try:
            request = rtu_frame(bytes([3, 0, 0, 0, 2]))
            begun_s = time.monotonic()
            os.write(device, request)
            assert select.select([device], [], [], 5.0)[0]
            took_s = time.monotonic() - begun_s
            assert len(os.read(device, 256)) == 9
        finally:
            os.close(device)
    character_s = 11 / 9600
    assert took_s >= (8 + 9 + 3.5) * character_s + 0.01


@pytest.mark.parametrize(
    ("bus", "t35_s", "character_s"),
    [
        ({"baud_rate": 19200, "parity": "E", "stop_bits": 1}, 3.5 * 11 / 19200, 11 / 19200),
        ({"baud_rate": 38400, "parity": "N", "stop_bits": 1}, 1.75e-3, 10 / 38400),
    ],
)
def test_the_line_s_timing_is_the_specification_s(
    bus: dict[str, Any], t35_s: float, character_s: float
) -> None:
    timing = Timing.of(bus)
    assert timing.t35_s == pytest.approx(t35_s)
    assert timing.character_s == pytest.approx(character_s)


@pytest.mark.parametrize("bus", [{"baud_rate": 1}, {"baud_rate": "x"}, {"turnaround_s": -1.0}])
def test_lines_that_cannot_be(bus: dict[str, Any]) -> None:
    with pytest.raises(RigSettingsError):
        Timing.of(bus)


def test_a_protocol_that_it_does_not_speak() -> None:
    with pytest.raises(RigSettingsError, match="protocol = 'profinet'"):
        replace(SETTINGS, protocol="profinet")


def test_the_datastore_s_own_rules() -> None:
    """What reaches the drive past pymodbus's server: other units, coils."""
    drive = Wound().drive
    assert asyncio.run(drive.async_getValues(2, 3, 0, 1)) == 1
    assert asyncio.run(drive.async_getValues(1, 1, 0, 1)) == 1
    assert asyncio.run(drive.async_setValues(1, 5, 0x0100, [1])) == 1
    assert asyncio.run(drive.async_getValues(1, 3, 0, 1)) == [0x5342]
    assert struct.pack(">H", 0x5342) == b"SB"
