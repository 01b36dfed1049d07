"""libmodbus and mbpoll, which are not ours, on both ends of our Modbus."""

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.clock import SYSTEM_CLOCK
from drivers.modbus.library import load_profile
from drivers.modbus.lines import RtuLine, TcpLine
from drivers.modbus.master import ModbusAxis
from drivers.modbus.settings import ModbusDriveSettings, ModbusSettings
from servo_bench.rig import RigConfig, load_rig
from sim_rig.process import spawn
from tests.contract_axis import check_axis, play
from tests.modbus_peer import rtu_frame
from tests.strangers import libmodbus

pytestmark = [
    pytest.mark.wire,
    pytest.mark.skipif(
        libmodbus.NAME is None, reason="libmodbus is not here: apt-get install libmodbus5"
    ),
]
needs_mbpoll = pytest.mark.skipif(
    shutil.which("mbpoll") is None, reason="mbpoll is not here: apt-get install mbpoll"
)
needs_socat = pytest.mark.skipif(
    shutil.which("socat") is None, reason="socat is not here: apt-get install socat"
)
PERIOD_S = 0.02
BAUD = 115200


def settings(line: TcpLine | RtuLine) -> ModbusSettings:
    drive = ModbusDriveSettings(1, load_profile("generic"), 65536)
    return ModbusSettings(line, drive, PERIOD_S)


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port: int = listener.getsockname()[1]
    return port


@contextmanager
def pty_pair(folder: Path) -> Iterator[tuple[str, str]]:
    """Two devices, each the other's far end."""
    ends = folder / "near", folder / "far"
    command = ["socat", *(f"pty,raw,echo=0,link={end}" for end in ends)]
    with subprocess.Popen(command) as process:
        until_s = time.monotonic() + 10.0
        while not all(end.exists() for end in ends):
            assert time.monotonic() < until_s, "socat did not start"
            SYSTEM_CLOCK.sleep_s(0.01)
        yield str(ends[0]), str(ends[1])
        process.terminate()


@pytest.fixture(params=["modbus-tcp", "modbus-rtu"])
def rig(request: pytest.FixtureRequest) -> Iterator[RigConfig]:
    """Our software rig, at a speed that everybody knows."""
    config = load_rig(f"rigs/{request.param}.toml").on_a_free_port()
    if request.param == "modbus-rtu":
        config = config.with_bus(baud_rate=BAUD)
    with spawn(config.simulation_settings()) as running:
        yield config.with_bus(**running.bus)


# our master, their slave


def test_our_master_keeps_its_promises_with_their_tcp_server() -> None:
    port = free_port()
    with libmodbus.tcp_drive(port) as drive:
        axis = settings(TcpLine("127.0.0.1", port))
        check_axis(lambda: ModbusAxis(axis), lambda: drive.enabled, period_s=PERIOD_S)


@needs_socat
def test_our_master_keeps_its_promises_with_their_rtu_server(tmp_path: Path) -> None:
    with pty_pair(tmp_path) as (near, far):

        def wake() -> None:
            device = os.open(near, os.O_RDWR | os.O_NOCTTY)
            os.write(device, rtu_frame(bytes([3, 0, 0, 0, 1])))
            os.close(device)

        with libmodbus.rtu_drive(far, BAUD, wake) as drive:
            axis = settings(RtuLine(near, BAUD, "N", 2))
            check_axis(lambda: ModbusAxis(axis), lambda: drive.enabled, period_s=PERIOD_S)


def test_a_velocity_arrives_as_it_was_sent_and_a_position_as_it_was_told() -> None:
    port = free_port()
    with (
        libmodbus.tcp_drive(port) as drive,
        ModbusAxis(settings(TcpLine("127.0.0.1", port))) as axis,
    ):
        samples = play(axis, [-1.0] * 10, PERIOD_S)
        raw = drive.words[0x0101] << 16 | drive.words[0x0102]
        assert raw - (1 << 32) == round(-65536 / 6.283185307179586)
        known = [s.motor_position_counts for s in samples if s.motor_position_counts is not None]
        assert known[-1] < known[0] <= 0


# their master, our slave


def context(rig: RigConfig) -> libmodbus.Client:
    if "device" in rig.bus:
        device = str(rig.bus["device"]).encode()
        return libmodbus.Client(lambda lib: lib.modbus_new_rtu(device, BAUD, b"N", 8, 2))
    port = int(rig.bus["port"])
    return libmodbus.Client(lambda lib: lib.modbus_new_tcp(b"127.0.0.1", port))


def test_their_master_enables_and_moves_our_slave(rig: RigConfig) -> None:
    client = context(rig)
    try:
        assert client.read(0x0000, 2) == [0x5342, 402]
        for word in (0x06, 0x07, 0x0F):
            client.write(0x0100, word)
        state = client.write_and_read(0x0100, [0x0F, 0, 20_000], 0x0200, 15)
        assert state[0] & 0x6F == 0x27, "function 23 writes before it reads"
        client.write(0x0101, 0, 10_000)
        start = client.read(0x0203, 2)
        while client.read(0x0203, 2) == start:
            pass
        with pytest.raises(OSError, match="libmodbus") as refused:
            client.write(0x0200, 1)
        assert refused.value.errno == libmodbus.NOBASE + 2
        with pytest.raises(OSError, match="libmodbus") as refused:
            client.write(0x001A, 99)
        assert refused.value.errno == libmodbus.NOBASE + 3
    finally:
        client.close()


@needs_mbpoll
def test_mbpoll_reads_and_writes_our_slave(rig: RigConfig) -> None:
    if "device" in rig.bus:
        where = ["-m", "rtu", "-b", str(BAUD), "-P", "none", "-s", "2", str(rig.bus["device"])]
    else:
        where = ["-m", "tcp", "-p", str(rig.bus["port"]), str(rig.bus["host"])]
    base = ["mbpoll", "-1", "-a", "1", "-0", "-t", "4"]

    def poll(*words: str) -> str:
        said = subprocess.run([*base, *words], capture_output=True, text=True, check=False)
        return said.stdout + said.stderr

    assert "21314" in poll("-r", "0", "-c", "2", *where)
    assert "402" in poll("-r", "0", "-c", "2", *where)
    assert "Written 1 reference" in poll("-r", str(0x0010), *where, "250")
    assert "250" in poll("-r", str(0x0010), "-c", "1", *where)
    assert "Illegal data address" in poll("-r", str(0x0300), "-c", "1", *where)
