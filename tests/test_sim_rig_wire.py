"""The software rig as strangers meet it: its own processes, real frames, a plain master."""

import json
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace

import canopen
import numpy as np
import pytest

from sim_rig.errors import RigSettingsError, SimRigError
from sim_rig.model import Model
from sim_rig.process import SpawnedRig, settings_from_json
from tests.wire import (
    COUNTS,
    DRIVE,
    DRIVE_STATE,
    ENCODER,
    LOAD,
    MASTER,
    NOMINAL,
    RPDO,
    SETTINGS,
    SYNC,
    PlainMaster,
    spawned,
)

pytestmark = pytest.mark.wire
RAD = 2 * np.pi / COUNTS
HEARTBEAT = 0x700 + MASTER


@pytest.fixture
def rig() -> Iterator[SpawnedRig]:
    with spawned() as running:
        yield running


@pytest.fixture
def master(rig: SpawnedRig) -> Iterator[PlainMaster]:
    with PlainMaster(rig.bus) as plain:
        yield plain


def position(master: PlainMaster) -> int:
    raw = master.sdo(DRIVE, 0x6064)
    return raw - 2**32 if raw >> 31 else raw


def test_the_python_canopen_library_knows_it(rig: SpawnedRig) -> None:
    """A stranger's master: identity, PDO configuration, SYNC and what comes of it."""
    network = canopen.Network()
    network.connect(**rig.bus)
    try:
        drive = network.add_node(DRIVE, "sim_rig/eds/sim_drive.eds")
        assert drive.sdo["Identity object"]["Product code"].raw == 402
        assert drive.sdo[0x1008].raw == "servo-bench simulated drive"
        drive.tpdo.read()
        state = drive.tpdo[1]
        assert [entry.index for entry in state] == [0x6041, 0x6064, 0x6077]
        state.clear()
        state.add_variable(0x6041)
        state.add_variable(0x606C)
        state.cob_id, state.trans_type, state.enabled = 0x1A0, 1, True
        state.save()
        drive.nmt.state = "OPERATIONAL"
        network.sync.start(0.02)  # one SYNC's answer may be there before it is waited for
        assert state.wait_for_reception(timeout=5.0) is not None
        network.sync.stop()
        assert state[0x6041].raw & 0x6F == 0x40
        with pytest.raises(canopen.SdoAbortedError) as refused:
            drive.sdo[0x60C2][2].raw = -4
        assert refused.value.code == 0x06090030
    finally:
        network.disconnect()


def test_a_reset_node_boots(master: PlainMaster) -> None:
    for node in (DRIVE, ENCODER):
        master.send(0, bytes([129, node]))
        assert bytes(master.expect(0x700 + node).data) == b"\0"


def test_a_run_over_the_wire_is_the_simulation_of_its_sync_times(master: PlainMaster) -> None:
    """Every sample within half a count, whatever this machine's scheduler did to the SYNCs."""
    master.enable()
    master.cycle(0x0F)
    commands = np.random.default_rng(4).choice([-30_000, 30_000], 150)
    motor, load, times_us = [], [], []
    start_motor, start_load = position(master), master.sdo(ENCODER, 0x6004)
    assert start_motor == start_load == 0
    for command in commands.tolist():
        master.send(RPDO, struct.pack("<Hi", 0x0F, command))
        master.send(SYNC)
        state = master.expect(DRIVE_STATE)
        motor.append(struct.unpack_from("<i", state.data, 2)[0])
        angle, stamp = struct.unpack("<II", master.expect(LOAD).data)
        load.append((angle + 2**27) % 2**28 - 2**27)
        times_us.append(stamp)
    durations_us = np.diff(np.array(times_us, np.uint32)).astype(float)
    truth = Model(NOMINAL).simulate(commands[:-1] * RAD, durations_us * 1e-6)
    assert np.abs(np.array(motor[:-1]) * RAD - truth.motor_angle_rad).max() <= 0.5001 * RAD
    assert np.abs(np.array(load[:-1]) * RAD - truth.load_angle_rad).max() <= 0.5001 * RAD
    assert durations_us.sum() > 0


def test_enable_turn_quick_stop(master: PlainMaster) -> None:
    master.enable()
    for _ in range(10_000):
        master.cycle(0x0F, 40_000)
        if position(master) > 2000:
            break
    master.cycle_until(0x02, 0x40)
    stopped_at = position(master)
    assert stopped_at > 2000
    assert master.sdo(DRIVE, 0x606C) == 0
    assert abs(position(master) - stopped_at) <= 1


def test_a_master_that_falls_silent_leaves_a_drive_that_stops(master: PlainMaster) -> None:
    """No SYNC any more, no heartbeat: the rig moves on in real time and brakes by itself."""
    master.sdo(DRIVE, 0x1016, 1, MASTER << 16 | 150)
    master.enable()
    for _ in range(20):
        master.send(HEARTBEAT, b"\x05")  # in each: a cycle may take long where the machine is taken
        master.cycle(0x0F, 40_000)
    emergency = master.expect(0x80 + DRIVE)
    assert struct.unpack_from("<H", emergency.data) == (0x8130,)
    for _ in range(100_000):
        if master.sdo(DRIVE, 0x6041) & 0x6F == 0x40:
            break
    assert master.sdo(DRIVE, 0x6041) & 0x6F == 0x40
    assert master.sdo(DRIVE, 0x606C) == 0
    assert position(master) > 0


def test_a_fault_and_its_reset(master: PlainMaster) -> None:
    master.sdo(DRIVE, 0x6007, 0, 1, 2)
    master.sdo(DRIVE, 0x1016, 1, MASTER << 16 | 100)
    master.enable()
    master.send(HEARTBEAT, b"\x05")
    master.expect(0x80 + DRIVE)
    for _ in range(100_000):
        if master.cycle(0x0F) & 0x4F == 0x08:
            break
    master.send(HEARTBEAT, b"\x05")
    assert master.cycle(0x00) & 0x4F == 0x08
    master.cycle(0x80)
    assert master.cycle(0x80) & 0x4F == 0x40


def test_it_beats(master: PlainMaster) -> None:
    for node in (DRIVE, ENCODER):
        master.sdo(node, 0x1017, 0, 20, 2)
    for node in (DRIVE, ENCODER):
        for _ in range(3):
            assert bytes(master.expect(0x700 + node).data) == b"\x7f"


def test_another_plant_can_stand_behind_the_wire() -> None:
    with (
        spawned(plant="tests.truth.toy_plant:make", seed=3) as rig,
        PlainMaster(rig.bus) as master,
    ):
        master.enable()
        for _ in range(10_000):
            master.cycle(0x0F, 40_000)
            if position(master) > 2000:
                break
        assert position(master) > 2000
        master.cycle_until(0x02, 0x40)


# the process itself


def test_it_and_its_hub_end_together() -> None:
    with spawned() as rig:
        address = (str(rig.bus["host"]), int(rig.bus["port"]))
        socket.create_connection(address).close()
    assert rig.process.returncode == 0
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(address)


def test_a_rig_that_dies_is_no_success() -> None:
    running = spawned()
    process = running.__enter__().process
    process.kill()
    process.wait()
    with pytest.raises(SimRigError, match="ended while it was needed"):
        running.__exit__(None, None, None)


def test_a_lost_hub_is_said() -> None:
    """python-can's client would wait for ever on a connection that is closed."""
    hub = [sys.executable, "-m", "sim_rig.canopen.hub"]
    with subprocess.Popen(hub, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        port = json.loads(process.stdout.readline())["port"]
        bus = {"interface": "socketcand", "host": "127.0.0.1", "port": port, "channel": "can0"}
        running = spawned(bus=bus, host_hub=False)
        rig = running.__enter__()
        process.send_signal(signal.SIGTERM)
        rig.process.wait(10.0)
        with pytest.raises(SimRigError, match="hub closed"):
            running.__exit__(None, None, None)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"plant": "no.such.module:thing"}, "cannot be loaded"),
        ({"plant": "nothing"}, "package.module:factory"),
        ({"plant": "math:pi"}, "not callable"),
        ({"bus": {"interface": "socketcand", "host": "10.1.1.1"}}, "this machine only"),
        ({"bus": {"interface": "nonsense"}}, "cannot open its bus"),
    ],
)
def test_why_it_did_not_start(changes: dict[str, object], words: str) -> None:
    with pytest.raises(SimRigError, match=words), spawned(**changes):
        raise AssertionError("it started")


def test_two_rigs_on_one_port() -> None:
    with spawned() as first:
        taken = dict(first.bus)
        with pytest.raises(SimRigError, match="cannot listen"), spawned(bus=taken):
            raise AssertionError("it started")


@pytest.mark.parametrize("line", ["", "[]", "{}", '{"nominal": {}}', "{"])
def test_settings_are_read_or_refused(line: str) -> None:
    with pytest.raises(RigSettingsError, match="one line of JSON"):
        settings_from_json(line)


def test_effects_belong_to_the_rigs_own_model() -> None:
    gravity = {"gravity_imbalance": {"torque_nm": 0.01}}
    with pytest.raises(RigSettingsError, match="only 'model' has them"):
        replace(SETTINGS, plant="tests.truth.toy_plant:make", effects=gravity)
