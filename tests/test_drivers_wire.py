"""The CANopen master against the software rig, over real TCP."""

import logging
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import pytest

import sim_rig
from drivers.axis import Axis, Sample, WireEvent
from drivers.canopen.cia402 import POWERED, decode_state
from drivers.canopen.line import open_bus
from drivers.canopen.master import CanopenAxis
from drivers.canopen.settings import (
    BusOptions,
    CanopenSettings,
    DriveSettings,
    EncoderSettings,
    NodeSettings,
)
from drivers.clock import SYSTEM_CLOCK
from drivers.errors import DriveError, DriverError, SettingsError, WireError
from sim_rig.errors import SimRigError
from sim_rig.process import SpawnedRig, spawn
from sim_rig.settings import Nominal, RigSettings
from tests.contract_axis import check_axis, play

pytestmark = pytest.mark.wire

EDS = Path(sim_rig.__file__).parent / "eds"
PERIOD_S = 0.008
RIG = RigSettings(
    nominal=Nominal(0.03606, 0.00025, 0.3466, 27.08, backlash_gap_rad=0.026),
    bus={"interface": "socketcand"},
    drive_node_id=1,
    motor_counts_per_revolution=65536,
    encoder_node_id=2,
    load_counts_per_revolution=65536,
)


@pytest.fixture(autouse=True)
def quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """The libraries log what the tests provoke."""
    for name in ("canopen", "can"):
        monkeypatch.setattr(logging.getLogger(name), "propagate", False)


@pytest.fixture(scope="module")
def rig() -> Iterator[SpawnedRig]:
    with spawn(RIG) as spawned:
        yield spawned


def settings(bus: BusOptions, **changes: Any) -> CanopenSettings:
    drive = DriveSettings(NodeSettings(1, EDS / "sim_drive.eds", 0, 402), 65536)
    return CanopenSettings(
        bus=bus,
        drive=replace(drive, **changes),
        encoder=EncoderSettings(NodeSettings(2, EDS / "sim_encoder.eds", 0, 406), 65536),
        period_s=PERIOD_S,
    )


def is_enabled(bus_options: BusOptions) -> bool:
    """Ask the drive itself for its statusword, over a bus of our own."""
    request = struct.pack("<BHB4x", 0x40, 0x6041, 0)
    with open_bus(bus_options) as bus:
        bus.send(can.Message(arbitration_id=0x601, data=request, is_extended_id=False))
        while True:
            frame = bus.recv(5.0)
            assert frame is not None, "the drive does not answer an SDO"
            if frame.arbitration_id == 0x581 and frame.data[:4] == b"\x4b\x41\x60\x00":
                return decode_state(struct.unpack_from("<H", frame.data, 4)[0]) in POWERED


def say(bus_options: BusOptions, cob_id: int, data: bytes) -> None:
    """Put a frame on the bus as somebody else."""
    with open_bus(bus_options) as bus:
        bus.send(can.Message(arbitration_id=cob_id, data=data, is_extended_id=False))


def play_until_fatal(axis: Axis, samples: list[Sample]) -> list[WireEvent]:
    """Play standstill until something fatal is told; every event on the way."""
    events: list[WireEvent] = []
    for slot in range(1000):
        end_ns = SYSTEM_CLOCK.now_ns() + round(PERIOD_S * 1e9)
        axis.command(0.0, slot)
        samples += axis.samples(end_ns)
        events += axis.events()
        if any(event.fatal for event in events):
            return events
        SYSTEM_CLOCK.sleep_until(end_ns)
    raise AssertionError("nothing fatal was told in 1000 slots")


def test_the_master_keeps_the_promise_of_every_axis(rig: SpawnedRig) -> None:
    check_axis(
        lambda: CanopenAxis(settings(rig.bus)), lambda: is_enabled(rig.bus), period_s=PERIOD_S
    )


def test_the_rig_moves_as_it_is_told_and_the_load_follows(rig: SpawnedRig) -> None:
    with CanopenAxis(settings(rig.bus)) as axis:
        samples = play(axis, [0.0] * 3 + [1.5] * 100 + [0.0] * 60, PERIOD_S)
        assert [e.text for e in axis.events() if e.fatal] == []
    complete = [s for s in samples if s.motor_position_rad is not None]
    moved = (complete[-1].motor_position_rad or 0) - (complete[0].motor_position_rad or 0)
    load = (complete[-1].load_angle_rad or 0) - (complete[0].load_angle_rad or 0)
    assert moved > 0.5
    assert abs(moved - load) <= RIG.nominal.backlash_gap_rad + 4e-4
    velocities = [s.motor_velocity_rad_s or 0 for s in samples]
    assert max(velocities) > 1.0
    assert abs(velocities[-1]) < 0.1
    # integral of the drive's own velocity = its own position: two scalings, one truth
    times = [(s.device_time_us or 0) * 1e-6 for s in samples]
    travelled = sum(
        (velocities[k] + velocities[k + 1]) / 2 * (times[k + 1] - times[k])
        for k in range(len(samples) - 1)
    )
    assert travelled == pytest.approx(moved, rel=0.05)


def test_the_direction_turns_command_and_answer_alike(rig: SpawnedRig) -> None:
    """Of drive and encoder together: turned alone, either would go against the other."""
    turned = settings(rig.bus, direction=-1)
    both = replace(turned, encoder=replace(turned.encoder, direction=-1))
    check_axis(lambda: CanopenAxis(both), lambda: is_enabled(rig.bus), period_s=PERIOD_S)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"node": NodeSettings(9, EDS / "sim_drive.eds")}, WireError, "drive 9 does not answer"),
        (
            {"node": NodeSettings(1, EDS / "sim_drive.eds", 0, 0x61500000)},
            DriveError,
            r"product_code = 0x192 .*configuration says 0x61500000",
        ),
        (
            {"counts_per_revolution": 4096},
            SettingsError,
            r"0x608F.*= 65536 / 1.*counts_per_revolution = 4096",
        ),
        ({"node": NodeSettings(1, EDS / "no.eds")}, SettingsError, "No such file"),
    ],
)
def test_a_configuration_that_is_not_this_rig_is_refused(
    rig: SpawnedRig, change: dict[str, Any], error: type[DriverError], words: str
) -> None:
    with pytest.raises(error, match=words), CanopenAxis(settings(rig.bus, **change)):
        pytest.fail("entered")
    assert not is_enabled(rig.bus)


def test_a_period_that_the_drive_refuses(rig: SpawnedRig) -> None:
    refused = replace(settings(rig.bus), period_s=0.2)
    words = r"drive 1 refuses to write 0x60C2.*0x06090030.*period_s = 0\.2: choose a period"
    with pytest.raises(DriveError, match=words), CanopenAxis(refused):
        pytest.fail("entered")
    assert not is_enabled(rig.bus)


def test_a_drive_that_somebody_resets_mid_run(rig: SpawnedRig) -> None:
    samples: list[Sample] = []
    with CanopenAxis(settings(rig.bus)) as axis:
        say(rig.bus, 0x000, b"\x81\x01")
        events = play_until_fatal(axis, samples)
    assert any(e.kind == "node restarted" and "drive 1" in e.text for e in events)
    assert not is_enabled(rig.bus)


def test_an_emergency_mid_run(rig: SpawnedRig) -> None:
    with CanopenAxis(settings(rig.bus)) as axis:
        say(rig.bus, 0x081, struct.pack("<HB5x", 0x4310, 1))
        (event,) = [e for e in play_until_fatal(axis, []) if e.fatal]
    assert "emergency 0x4310 (drive too hot)" in event.text
    assert not is_enabled(rig.bus)


def test_a_master_that_falls_silent_is_noticed_by_the_drive(rig: SpawnedRig) -> None:
    """The drive stops by itself; the master finds the emergency when it wakes up again."""
    with CanopenAxis(settings(rig.bus)) as axis, open_bus(rig.bus) as other:
        while True:
            frame = other.recv(5.0)
            assert frame is not None, "the drive never noticed"
            if frame.arbitration_id == 0x081:
                break
        events = play_until_fatal(axis, [])
        assert any("0x8130 (heartbeat of the master lost)" in e.text for e in events)
    assert not is_enabled(rig.bus)
    with CanopenAxis(settings(rig.bus)):  # and is itself again afterwards
        assert is_enabled(rig.bus)


def lose_the_rig(errors: list[WireError]) -> None:
    with spawn(RIG) as rig:
        try:
            with CanopenAxis(settings(rig.bus)) as axis:
                rig.process.terminate()
                rig.process.wait()
                play_until_fatal(axis, [])
        except WireError as error:
            errors.append(error)


def test_a_hub_that_dies_mid_run_is_a_wire_error() -> None:
    errors: list[WireError] = []
    with pytest.raises(SimRigError, match="ended while it was needed"):
        lose_the_rig(errors)
    (error,) = errors
    assert "is gone" in str(error)
    assert "Check server" in str(error)
    (note,) = error.__notes__
    assert "did not confirm its stop" in note
    assert "quick-stops by itself" in note
