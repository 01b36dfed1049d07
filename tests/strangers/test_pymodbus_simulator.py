"""pymodbus' simulator as the drive: its datastore, frames, and server are not ours."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient

from drivers.modbus.lines import RtuLine, TcpLine
from drivers.modbus.master import ModbusAxis
from tests.contract_axis import check_axis, play
from tests.strangers.pymodbus_drive import STATUSWORD, VELOCITY
from tests.strangers.test_libmodbus import (
    BAUD,
    PERIOD_S,
    free_port,
    needs_socat,
    pty_pair,
    settings,
)

pytestmark = pytest.mark.wire


@contextmanager
def simulator(*words: object) -> Iterator[None]:
    """The simulator in a process of its own, listening."""
    command = [sys.executable, "-m", "tests.strangers.pymodbus_drive", *map(str, words)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "listening\n"
            yield
        finally:
            process.terminate()


@pytest.fixture
def port() -> Iterator[int]:
    found = free_port()
    with simulator("tcp", found):
        yield found


@contextmanager
def registers(port: int) -> Iterator[ModbusTcpClient]:
    """A second client, which asks the simulator what our master has made of it."""
    client = ModbusTcpClient("127.0.0.1", port=port)
    assert client.connect()
    yield client
    client.close()


def test_our_master_keeps_its_promises_with_their_simulator(port: int) -> None:
    with registers(port) as client:

        def enabled() -> bool:
            answer = client.read_holding_registers(STATUSWORD, count=1, device_id=1)
            return answer.registers[0] & 0x6F == 0x27

        axis = settings(TcpLine("127.0.0.1", port))
        check_axis(lambda: ModbusAxis(axis), enabled, period_s=PERIOD_S)


def test_a_velocity_arrives_in_their_registers_and_their_position_comes_back(port: int) -> None:
    with registers(port) as client:
        with ModbusAxis(settings(TcpLine("127.0.0.1", port))) as axis:
            samples = play(axis, [-1.0] * 10, PERIOD_S)
            high, low = client.read_holding_registers(VELOCITY, count=2, device_id=1).registers
        assert (high << 16 | low) - (1 << 32) == round(-65536 / 6.283185307179586)
        known = [s.motor_position_counts for s in samples if s.motor_position_counts is not None]
        assert known[-1] < known[0] <= 0
        assert client.read_holding_registers(VELOCITY, count=2, device_id=1).registers == [0, 0]


@needs_socat
def test_our_master_plays_their_simulator_over_a_serial_line(tmp_path: Path) -> None:
    with pty_pair(tmp_path) as (near, far), simulator("rtu", far, BAUD):
        with ModbusAxis(settings(RtuLine(near, BAUD, "N", 2))) as axis:
            samples = play(axis, [1.0] * 25, PERIOD_S)
        known = [s.motor_position_counts for s in samples if s.motor_position_counts is not None]
        assert len(known) > 12
        assert known[-1] > known[0] >= 0
