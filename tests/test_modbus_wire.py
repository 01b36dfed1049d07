"""The Modbus master against the software rig: processes, TCP, and a pty; runs and their ends."""

import os
import select
import shutil
import signal
import socket
import subprocess
import termios
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from drivers.clock import SYSTEM_CLOCK
from drivers.modbus.master import ModbusAxis
from servo_bench.errors import BenchError, ConfigError, DriveError, RecordingError, WireError
from servo_bench.excitation.experiment import MSequence, Phase
from servo_bench.kernels.analysis import analyse
from servo_bench.recording.mcap_file import load
from servo_bench.rig import RigConfig, load_rig, rig_from_table
from servo_bench.run.axes import axis_settings, open_axis
from servo_bench.run.session import run
from sim_rig.errors import SimRigError
from sim_rig.process import spawn
from tests.contract_axis import check_axis, play
from tests.kill_campaign import children
from tests.modbus_peer import rtu_frame, tcp_frame
from tests.test_run_session import experiment, signal_bus_process, start_program, stop_after

pytestmark = pytest.mark.wire
PERIOD_S = 0.008
READ_STATE = bytes([3, 0x02, 0x00, 0, 12])
POWERED = {0x27, 0x07}


@pytest.fixture(params=["modbus-tcp", "modbus-rtu"])
def rig(request: pytest.FixtureRequest) -> Iterator[RigConfig]:
    """A software rig of its own, on a free port or a new pty."""
    yield from started(request.param)


@pytest.fixture
def tcp_rig() -> Iterator[RigConfig]:
    yield from started("modbus-tcp")


@pytest.fixture(scope="module")
def untouched_rig() -> Iterator[RigConfig]:
    """One for all who are refused before the drive is asked for anything that lasts."""
    yield from started("modbus-tcp")


def started(name: str) -> Iterator[RigConfig]:
    config = load_rig(f"rigs/{name}.toml").on_a_free_port()
    with spawn(config.simulation_settings()) as running:
        yield config.with_bus(**running.bus)


def state(rig: RigConfig) -> list[int]:
    """Twelve registers from the statusword on, asked by hand beside the axis."""
    if "device" in rig.bus:
        device = os.open(str(rig.bus["device"]), os.O_RDWR | os.O_NOCTTY)
        try:
            termios.tcflush(device, termios.TCIFLUSH)  # an answer to somebody who was killed
            os.write(device, rtu_frame(READ_STATE))
            got = b""
            while len(got) < 29:
                assert select.select([device], [], [], 5.0)[0], "the drive does not answer"
                got += os.read(device, 256)
        finally:
            os.close(device)
        data = got[3:27]
    else:
        address = str(rig.bus["host"]), int(rig.bus["port"])
        with closing(socket.create_connection(address, 5.0)) as connection:
            connection.sendall(tcp_frame(READ_STATE, 1))
            data = connection.recv(100)[9:]
    return [int.from_bytes(data[k : k + 2], "big") for k in range(0, 24, 2)]


def is_enabled(rig: RigConfig) -> bool:
    return state(rig)[0] & 0x6F in POWERED


def assert_standing(rig: RigConfig) -> None:
    before = state(rig)
    assert before[0] & 0x6F not in POWERED
    assert before[3:5] == state(rig)[3:5]


def test_the_master_keeps_the_promise_of_every_axis(rig: RigConfig) -> None:
    check_axis(lambda: open_axis(rig, PERIOD_S), lambda: is_enabled(rig), period_s=PERIOD_S)


def test_the_rig_moves_as_it_is_told_and_the_load_follows(rig: RigConfig) -> None:
    axis = open_axis(rig, PERIOD_S)
    assert isinstance(axis, ModbusAxis)
    with axis:
        samples = play(axis, [0.0] * 3 + [1.5] * 100 + [0.0] * 60, PERIOD_S)
        assert [event.text for event in axis.events() if event.fatal] == []
    full = [s for s in samples if s.motor_position_rad is not None]
    first, last = full[0], full[-1]
    moved = (last.motor_position_rad or 0.0) - (first.motor_position_rad or 0.0)
    load = (last.load_angle_rad or 0.0) - (first.load_angle_rad or 0.0)
    assert moved > 0.5
    assert abs(moved - load) <= rig.nominal.backlash_gap_rad + 4e-4
    assert max(s.motor_velocity_rad_s or 0.0 for s in full) > 1.0
    device_us = np.array([s.device_time_us or 0 for s in full])
    times_s = ((device_us - device_us[0]) % (1 << 32)) * 1e-6  # it wraps while this machine runs
    velocities = np.array([s.motor_velocity_rad_s or 0.0 for s in full])
    assert np.trapezoid(velocities, times_s) == pytest.approx(moved, rel=0.05)
    assert all(s.statusword is not None and s.statusword & 0x6F == 0x27 for s in full)
    assert max(s.motor_torque_nm or 0.0 for s in full) > 0.0


@pytest.mark.parametrize(
    ("drive", "error", "words"),
    [
        ({"counts_per_revolution": 4096}, ConfigError, r"is 65536, .*counts_per_revolution = 4096"),
        ({"unit": 7}, DriveError, "drive 7 at .* refuses to read vendor"),
    ],
)
def test_a_configuration_that_is_not_this_rig_is_refused(
    untouched_rig: RigConfig,
    tmp_path: Path,
    drive: dict[str, int],
    error: type[BenchError],
    words: str,
) -> None:
    table = {"drive": untouched_rig.drive.model_copy(update=drive)}
    other = untouched_rig.model_copy(update=table)
    with pytest.raises(error, match=words):
        run(experiment(), other, tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []
    assert_standing(untouched_rig)


def test_a_line_that_cannot_hold_the_period_is_refused_before_a_file_is_opened(
    tmp_path: Path,
) -> None:
    slow = load_rig("rigs/modbus-rtu.toml").with_bus(baud_rate=115200)
    words = r"19 \+ 33 bytes at 115200 Bd 8N2.*> 8 ms\. Use 230400 Bd"
    with pytest.raises(ConfigError, match=words):
        run(experiment(), slow, tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []


def test_rig_files_that_cannot_be() -> None:
    table = load_rig("rigs/modbus-tcp.toml").model_dump()
    cases: list[tuple[dict[str, object], str]] = [
        ({"bus": {"host": "127.0.0.1", "baud": 1}}, r"has no baud\. It takes"),
        ({"bus": {"port": 502}}, "host"),
        ({"encoder": load_rig("rigs/paper.toml").model_dump()["encoder"]}, "a second bus"),
        ({"drive": table["drive"] | {"profile": "no-such"}}, "no Modbus drive profile 'no-such'"),
        ({"drive": table["drive"] | {"protocol": "modbus-rtu"}}, "has no host"),
    ]
    for changes, words in cases:
        with pytest.raises(ConfigError, match=words):
            axis_settings(rig_from_table(table | changes, "test"), PERIOD_S)
    with pytest.raises(ConfigError, match="unit"):
        rig_from_table(table | {"drive": table["drive"] | {"unit": 300}}, "test")
    with pytest.raises(ConfigError, match="on modbus-tcp"):
        load_rig("rigs/modbus-tcp.toml").canopen_settings(PERIOD_S)
    with pytest.raises(ConfigError, match="on canopen"):
        load_rig("rigs/paper.toml").modbus_settings(PERIOD_S)


def test_a_run_records_what_it_played(rig: RigConfig, tmp_path: Path) -> None:
    plan = experiment()
    summary = run(plan, rig, tmp_path / "run.mcap")
    recording = load(tmp_path / "run.mcap")
    schedule = plan.schedule()
    assert summary.played + summary.missed == summary.slots == schedule.slots
    slots = recording["slot"]
    np.testing.assert_array_equal(
        recording["velocity_command_rad_s"], schedule.velocity_rad_s[slots]
    )
    assert recording.rig == rig
    motor_rad = recording["motor_position_rad"]
    known = np.isfinite(motor_rad)
    assert known.mean() > 0.5
    # a command acts until the next one comes, and on a busy machine that may be late
    lasted_s = np.diff(recording["asked_ns"]) * 1e-9
    command_rad_s = recording["velocity_command_rad_s"]
    led_rad = np.concatenate(([0.0], np.cumsum(command_rad_s[:-1] * lasted_s)))
    followed_rad = motor_rad - motor_rad[known][0]
    late_rad = 2.0 * np.abs(command_rad_s).max() * np.abs(lasted_s - plan.period_s).sum()
    assert np.abs((followed_rad - led_rad)[known]).max() < 0.25 + late_rad
    still = recording["load_angle_rad"][recording["phase"] == Phase.STANDSTILL]
    assert np.ptp(still[np.isfinite(still)]) == 0.0
    assert_standing(rig)


def test_a_run_over_modbus_gives_kernels(tcp_rig: RigConfig, tmp_path: Path) -> None:
    """A machine taken away for 1 % of the slots, or a quarter of a second, may try again."""
    whole = MSequence(polynomial="435", amplitude_rad_s=2.0, length=255 + 16)
    plan = experiment().model_copy(update={"identification": whole, "memory": 4})
    refused = []
    for attempt in range(4):
        out = tmp_path / f"{attempt}.mcap"
        try:
            run(plan, tcp_rig, out)
            numbers = analyse(load(out)).numbers()
        except (RecordingError, WireError) as error:
            refused.append(str(error))
        else:
            assert numbers
            return
    raise AssertionError(refused)


def kill_whole_bench(rig: RigConfig, folder: Path) -> None:
    with start_program(rig, folder, folder / "run.mcap") as process:
        assert process.stdout is not None
        for line in process.stdout:
            if int(line.split()[1]) > 60:
                break
        (loop,) = children(process.pid)
        (supervisor,) = children(loop)
        for pid in (supervisor, loop):  # else one would hear of it, and stop the rig itself
            os.kill(pid, signal.SIGKILL)
        process.kill()
        process.wait()


def test_kill_9_of_the_bus_process_and_its_supervisor_stops_the_drive(
    rig: RigConfig, tmp_path: Path
) -> None:
    kill = stop_after(60, lambda: signal_bus_process(signal.SIGKILL))
    with pytest.raises(WireError, match=r"killed by SIGKILL.*supervisor: stopped and disabled"):
        run(experiment(30.0), rig, tmp_path / "run.mcap", progress=kill)
    word, *_, error = state(rig)
    assert (word & 0x4F, error) == (0x40, 0), "off, without a fault: the supervisor's doing"
    assert_standing(rig)


def test_kill_9_of_the_bench_and_the_drive_stops_by_itself_within_its_timeout(
    rig: RigConfig, tmp_path: Path
) -> None:
    """Nobody asks it anything until its timeout has passed: then it says itself that it stopped."""
    kill_whole_bench(rig, tmp_path)
    timeout_s = rig.modbus_settings(PERIOD_S).own_stop_s
    assert timeout_s is not None
    SYSTEM_CLOCK.sleep_s(timeout_s + 0.3)
    word, *_, error = state(rig)
    assert word & 0x4F == 0x08, "in fault: the drive's own reaction, not the bench's"
    assert error == 0x8130
    assert_standing(rig)
    with open_axis(rig, PERIOD_S) as axis:  # the next run resets it
        assert is_enabled(rig)
        assert "fault reset" in [event.kind for event in axis.events()]


def test_a_rig_that_dies_mid_run_is_named_and_the_recording_kept(
    tmp_path: Path,
) -> None:
    config = load_rig("rigs/modbus-tcp.toml").on_a_free_port()
    settings = config.simulation_settings()
    out = tmp_path / "run.mcap"
    running = spawn(settings)
    up = running.__enter__()
    kill = stop_after(60, up.process.kill)
    with pytest.raises(WireError, match=r"is gone.*did not confirm its stop"):
        run(experiment(30.0), config.with_bus(**up.bus), out, progress=kill)
    with pytest.raises(SimRigError, match="ended while it was needed"):
        running.__exit__(None, None, None)
    assert load(out)["slot"].max() >= 59  # a slot that the machine slept through has no row


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        ("lost at=30 count=2", "answer lost"),
        ("late at=30", "answer lost"),
        ("damaged at=30", "answer lost"),
        ("exception at=30 code=6 count=3", "exception reply"),
        ("duplicated at=10 count=50", None),
    ],
)
@pytest.mark.parametrize("name", ["modbus-tcp", "modbus-rtu"])
def test_ordered_faults_are_named_and_leave_no_wrong_value(
    name: str, fault: str, kind: str | None
) -> None:
    """The device's own time says when a sample was taken: never before its slot's ask."""
    config = load_rig(f"rigs/{name}.toml").on_a_free_port().with_faults(fault)
    with spawn(config.simulation_settings()) as running:
        rig = config.with_bus(**running.bus)
        with open_axis(rig, PERIOD_S) as axis:
            samples = play(axis, [0.5] * 70, PERIOD_S)
            events = list(axis.events())
        assert_standing(rig)
    assert [event.text for event in events if event.fatal] == []
    assert kind is None or kind in [event.kind for event in events]
    known = [s for s in samples if s.device_time_us is not None]
    assert len(known) >= 20
    for sample in known:
        taken_us = (sample.asked_ns // 1000) & 0xFFFFFFFF
        assert ((sample.device_time_us or 0) - taken_us + 2) & 0xFFFFFFFF < 1 << 31, sample


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("bus-off", "no 'bus-off' on Modbus"),
        ("lost code=3", "lost has no 'code'"),
        ("late at=x", "is no whole number"),
        ("lost count=0", "count 1 or more"),
    ],
)
def test_faults_that_cannot_be_ordered(fault: str, words: str) -> None:
    config = load_rig("rigs/modbus-tcp.toml").with_faults(fault)
    with pytest.raises(ConfigError, match=words):
        config.simulation_settings()


@pytest.mark.skipif(shutil.which("socat") is None, reason="socat is not here")
def test_a_network_path_that_dies_leaves_a_drive_that_stops_by_itself(
    tcp_rig: RigConfig, tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    ends = (
        f"TCP-LISTEN:{port},bind=127.0.0.1,nodelay,reuseaddr",
        (f"TCP:127.0.0.1:{tcp_rig.bus['port']},nodelay"),
    )
    with subprocess.Popen(["socat", *ends]) as path:
        until_listening(port)
        cut = stop_after(60, path.kill)
        with pytest.raises(WireError, match=r"is gone.*did not confirm its stop.*by itself"):
            run(experiment(30.0), tcp_rig.with_bus(port=port), tmp_path / "run.mcap", progress=cut)
    own_stop_s = tcp_rig.modbus_settings(PERIOD_S).own_stop_s
    assert own_stop_s is not None
    SYSTEM_CLOCK.sleep_s(own_stop_s + 0.3)
    word, *_, error = state(tcp_rig)
    assert (word & 0x4F, error) == (0x08, 0x8130)
    assert_standing(tcp_rig)
    assert len(load(tmp_path / "run.mcap")) >= 60


def until_listening(port: int) -> None:
    """Without connecting: socat would take that for its only customer."""
    row = f"0100007F:{port:04X} 00000000:0000 0A"
    until_ns = SYSTEM_CLOCK.now_ns() + 10_000_000_000
    while row not in Path("/proc/net/tcp").read_text():
        assert SYSTEM_CLOCK.now_ns() < until_ns, "socat did not listen"
