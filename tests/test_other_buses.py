"""The same rig and the same run on other python-can interfaces, by the `[bus]` table alone."""

import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import can
import numpy as np
import pytest

from servo_bench.excitation.experiment import Experiment, MSequence, RandomBinary
from servo_bench.recording.mcap_file import load
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.session import run
from sim_rig.process import spawn

pytestmark = pytest.mark.wire
Bus = dict[str, str | int | float | bool]
MULTICAST_GROUP = "239.74.163.2"


def on(bus: Bus) -> RigConfig:
    return load_rig("rigs/paper.toml").model_copy(update={"bus": bus})


def assert_a_run_works(rig_bus: Bus, master_bus: Bus, out: Path) -> None:
    """Play a second and a half; the motor goes where it was sent, and most samples came."""
    speed_rad_s = 2.0
    plan = Experiment(
        name="short",
        rig="none",
        period_s=0.008,
        memory=8,
        standstill_s=0.1,
        lead_in=16,
        identification=MSequence(polynomial="2327", amplitude_rad_s=speed_rad_s, length=120),
        validation=RandomBinary(
            kind="random-binary", seed=2, amplitude_rad_s=speed_rad_s, length=32
        ),
    )
    with spawn(on(rig_bus).simulation_settings()):
        summary = run(plan, on(master_bus), out)
    recording = load(out)
    assert summary.played + summary.missed == summary.slots
    assert len(recording) == summary.played > 100
    assert np.isfinite(recording["load_angle_rad"]).mean() > 0.9
    assert np.nanmax(np.abs(np.diff(recording["motor_position_rad"]))) > 0.5 * speed_rad_s * 0.008


@pytest.fixture
def serial_line(tmp_path: Path) -> Iterator[tuple[str, str]]:
    """The two ends of a serial cable."""
    if shutil.which("socat") is None:
        pytest.skip("no socat here: it lays the cable between two serial ports (apt install socat)")
    pytest.importorskip("serial", reason="slcan needs pyserial: pip install 'python-can[serial]'")
    ends = str(tmp_path / "rig"), str(tmp_path / "master")
    command = ["socat", "-d", "-d", *(f"pty,raw,echo=0,link={end}" for end in ends)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as socat:
        assert socat.stderr is not None
        assert any("starting data transfer loop" in line for line in socat.stderr)
        try:
            yield ends
        finally:
            socat.terminate()


def test_slcan_over_a_serial_line(serial_line: tuple[str, str], tmp_path: Path) -> None:
    rig_bus, master_bus = (
        Bus(interface="slcan", channel=end, sleep_after_open=0.0) for end in serial_line
    )
    assert_a_run_works(rig_bus, master_bus, tmp_path / "run.mcap")


def test_udp_multicast_on_this_host(tmp_path: Path) -> None:
    pytest.importorskip(
        "msgpack", reason="udp_multicast needs msgpack: pip install 'python-can[multicast]'"
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    bus = Bus(interface="udp_multicast", channel=MULTICAST_GROUP, port=port, hop_limit=0)
    try:
        can.Bus(
            interface="udp_multicast", channel=MULTICAST_GROUP, port=port, ignore_config=True
        ).shutdown()
    except (can.CanError, OSError) as error:
        pytest.skip(f"this host has no multicast: {error}")
    assert_a_run_works(bus, bus, tmp_path / "run.mcap")
