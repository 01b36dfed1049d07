"""Node guarding, both sides: the slave that misses its master, the master that misses its drive."""

import socket
import struct
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import canopen
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen.budget import bus_budget
from drivers.canopen.guarding import guard_times
from drivers.canopen.master import CanopenAxis
from drivers.canopen.profile import load_profile
from drivers.canopen.settings import CanopenSettings
from drivers.canopen.stopline import CanopenStopLine
from drivers.errors import SettingsError
from sim_rig.canopen.cia402 import POWERED, State
from sim_rig.process import spawn
from sim_rig.settings import RigSettings
from tests.contract_axis import check_axis
from tests.fake_canopen import FakeRig
from tests.virtual_rig import VirtualRig, install
from tests.wire import DRIVE, MASTER, SETTINGS, LocalRig, PlainMaster, local_rig, spawned

GUARDED = load_profile("generic-node-guarding")
QUESTION = 0x700 + DRIVE
GUARD_MS, FACTOR = 100, 3
LIFE_US = GUARD_MS * FACTOR * 1000
SPEED_INCREMENTS_S = 40_000


def guarded_rig() -> LocalRig:
    rig = local_rig()
    rig.sdo(DRIVE, 0x100C, 0, GUARD_MS, 2)
    rig.sdo(DRIVE, 0x100D, 0, FACTOR, 1)
    return rig


def question(rig: LocalRig) -> list[bytes]:
    rig.sent.clear()
    rig.rig.receive_remote(QUESTION, rig.now_us)
    return rig.take(QUESTION)


# The slave


def test_it_answers_with_its_state_and_a_bit_that_toggles_from_0() -> None:
    rig = guarded_rig()
    assert [question(rig) for _ in range(3)] == [[b"\x7f"], [b"\xff"], [b"\x7f"]]
    rig.send(0, bytes([1, DRIVE]))
    assert question(rig) == [b"\x85"]
    rig.send(0, bytes([130, DRIVE]))  # reset communication: the bit begins anew
    assert question(rig) == [b"\x7f"]


def test_a_node_with_a_heartbeat_answers_no_question() -> None:
    rig = guarded_rig()
    rig.sdo(DRIVE, 0x1017, 0, 1000, 2)
    assert question(rig) == []
    rig.wait(10 * LIFE_US)
    assert not rig.take(0x80 + DRIVE), "and misses nobody"


@pytest.mark.parametrize(
    ("option", "state"),
    [
        (0, State.OPERATION_ENABLED),
        (1, State.FAULT),
        (2, State.SWITCH_ON_DISABLED),
        (3, State.SWITCH_ON_DISABLED),
    ],
)
def test_when_the_questions_end_the_drive_does_what_0x6007_says(option: int, state: State) -> None:
    rig = guarded_rig()
    rig.sdo(DRIVE, 0x6007, 0, option, 2)
    rig.sdo(DRIVE, 0x605A, 0, 2, 2)
    rig.enable()
    question(rig)
    for _ in range(20):
        rig.cycle(0x0F, SPEED_INCREMENTS_S)
    question(rig)
    asked_us = rig.now_us
    rig.wait(LIFE_US - 1)
    assert not rig.take(0x80 + DRIVE)
    assert rig.rig.drive.state is State.OPERATION_ENABLED
    rig.wait(1)
    emergencies = rig.take(0x80 + DRIVE)
    assert [struct.unpack_from("<H", data)[0] for data in emergencies] == [0x8130]
    assert rig.now_us - asked_us == LIFE_US
    rig.wait(1_500_000)
    assert rig.rig.drive.state is state
    moving = abs(rig.rig.machine.outputs.motor_velocity_rad_s) > 0.1
    assert moving == (option in (0, 2)), "0 goes on, 2 coasts (no friction here), 1 and 3 stop"


def test_nobody_is_missed_before_the_first_question() -> None:
    rig = guarded_rig()
    rig.enable()
    rig.wait(5 * LIFE_US)
    assert rig.rig.drive.state is State.OPERATION_ENABLED


# The master


@given(every_ms=st.integers(1, 60_000), timeout_ms=st.integers(2, 60_000))
def test_the_life_time_is_within_the_timeout_and_one_question_may_be_lost(
    every_ms: int, timeout_ms: int
) -> None:
    guard_ms, factor = guard_times(every_ms * 1e-3, timeout_ms * 1e-3)
    assert 2 <= factor <= 255
    assert timeout_ms - factor < guard_ms * factor <= timeout_ms
    if timeout_ms <= 255 * every_ms:
        assert guard_ms <= every_ms


def guarded_world(name: str, **changes: Any) -> tuple[VirtualRig, CanopenSettings]:
    install()
    world = VirtualRig(name, **changes)
    return world, world.canopen_settings(profile=GUARDED)


def test_the_contract_of_an_axis() -> None:
    world, settings = guarded_world("guarded contract")
    check_axis(
        lambda: world.axis(settings),
        lambda: world.powered,
        period_s=settings.period_s,
        clock=world.axis()._clock,
    )


def drive_on(world: VirtualRig, axis: CanopenAxis, slots: range) -> list[str]:
    """Play at 2 rad/s; the kinds of fatal events, at the first of which it ends."""
    for slot in slots:
        axis.samples(world.now_ns)
        axis.command(2.0, slot)
        axis.samples(world.now_ns + 7_000_000)
        world.pass_until(world.now_ns + 7_990_000)
        fatal = [event for event in axis.events() if event.fatal]
        if fatal:
            return [f"{event.kind}: {event.text}" for event in fatal]
    return []


def test_a_drive_whose_master_dies_stops_by_itself_and_one_whose_master_lives_does_not() -> None:
    world, settings = guarded_world("guarded death")
    axis = world.axis(settings)
    axis.__enter__()
    assert (world.rig.drive_node.store[0x100C, 0], world.rig.drive_node.store[0x100D, 0]) == (
        GUARD_MS,
        FACTOR,
    )
    assert not any(can_id == 0x700 + MASTER for can_id, _ in world.sent), "no heartbeat besides"
    assert drive_on(world, axis, range(200)) == []
    assert world.powered
    died_ns = world.now_ns  # nothing is sent any more
    while world.powered and world.now_ns < died_ns + 2_000_000_000:
        world.pass_until(world.now_ns + 1_000_000)
    ramp_s = 0.25  # 2 rad/s on 0x6085, and the axis must stand
    axis._line.bus.shutdown()
    assert 0.15 < (world.now_ns - died_ns) * 1e-9 < settings.drive.heartbeat_timeout_s + ramp_s
    assert abs(world.velocity_rad_s) < 0.1


def test_leaving_disarms_the_life_time() -> None:
    world, settings = guarded_world("guarded leave")
    with world.axis(settings):
        pass
    assert world.rig.drive_node.store[0x100D, 0] == 0
    world.waiting.clear()
    world.pass_until(world.now_ns + 2_000_000_000)
    assert not [frame for frame in world.waiting if frame.arbitration_id == 0x80 + DRIVE]


def test_the_supervisors_stop_disarms_it_too() -> None:
    world, settings = guarded_world("guarded supervised")
    axis = world.axis(settings)
    axis.__enter__()
    assert drive_on(world, axis, range(30)) == []
    axis._line.bus.shutdown()
    line = CanopenStopLine(settings, axis._clock)
    assert line.stop() is None
    line.close()
    assert not world.powered
    assert world.rig.drive_node.store[0x100D, 0] == 0


def test_a_drive_that_does_not_answer_is_told() -> None:
    world, settings = guarded_world("mute")
    guarding = world.rig.drive_node._guarding
    with world.axis(settings) as axis:
        assert drive_on(world, axis, range(20)) == []
        answer = guarding.answer
        guarding.answer = lambda *asked: answer(*asked) and None  # type: ignore[method-assign]
        (fatal,) = drive_on(world, axis, range(20, 200))
    assert fatal.startswith("guarding unanswered: drive 1 has not answered node guarding for 0.3")
    assert not world.powered


def test_one_answer_that_is_lost_ends_nothing() -> None:
    world, settings = guarded_world("one answer lost")
    guarding = world.rig.drive_node._guarding
    answer, lost = guarding.answer, iter([False] * 4 + [True])

    def lossy(nmt_state: int, time_us: int) -> bytes | None:
        data = answer(nmt_state, time_us)
        return None if next(lost, False) else data

    guarding.answer = lossy  # type: ignore[method-assign]
    with world.axis(settings) as axis:
        assert drive_on(world, axis, range(200)) == []
    assert not list(lost), "it was lost"


def test_an_answer_with_the_toggle_bit_of_the_one_before_is_none() -> None:
    world, settings = guarded_world("toggle")
    guarding = world.rig.drive_node._guarding
    with world.axis(settings) as axis:
        assert drive_on(world, axis, range(20)) == []
        answer = guarding.answer

        def stale(nmt_state: int, time_us: int) -> bytes | None:
            data = answer(nmt_state, time_us)
            return None if data is None else bytes([data[0] & 0x7F])

        guarding.answer = stale  # type: ignore[method-assign]
        (fatal,) = drive_on(world, axis, range(20, 200))
    assert fatal.startswith("guarding unanswered")


def test_a_node_that_restarts_is_told_by_its_boot_up_message() -> None:
    world, settings = guarded_world("restart", faults=("reset node=drive at=20",))
    with world.axis(settings) as axis:
        fatal = drive_on(world, axis, range(200))
    assert "node restarted" in " ".join(fatal)


# What cannot be


@pytest.mark.wire
def test_a_bus_without_remote_frames_is_refused_unless_acknowledged() -> None:
    with spawned() as rig:
        plain = VirtualRig("only settings").canopen_settings(profile=GUARDED)
        settings = replace(plain, bus=rig.bus)
        refusal = r"socketcand carries no remote frames: it would"
        with pytest.raises(SettingsError, match=refusal), CanopenAxis(settings):
            pytest.fail("entered")
        drive = replace(settings.drive, without_watchdog=True)
        with CanopenAxis(replace(settings, drive=drive)) as axis:
            (event,) = axis.events()
    assert event.kind == "master not watched"


def test_a_drive_without_the_objects_is_refused_or_acknowledged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = FakeRig(tmp_path, monkeypatch)
    settings = fake.settings(profile=GUARDED)  # the fake drive has neither
    refusal = r"has no 0x100C.*without_watchdog = true"
    with pytest.raises(SettingsError, match=refusal), fake.axis(settings):
        pytest.fail("entered")
    assert fake.nothing_enabled()
    acknowledged = fake.settings(profile=GUARDED, without_watchdog=True)
    with fake.axis(acknowledged) as axis:
        assert "master not watched" in {event.kind for event in axis.events()}
        assert fake.drive[0x1017, 0] == 100, "its heartbeat is heard instead"


def test_the_bus_budget_counts_question_and_answer_instead_of_two_heartbeats() -> None:
    world, settings = guarded_world("budget")
    guarded = {frame.name: frame for frame in bus_budget(settings).frames}
    plain = {frame.name: frame for frame in bus_budget(world.canopen_settings()).frames}
    assert guarded["heartbeats"].per_period == pytest.approx(plain["heartbeats"].per_period / 3)
    assert guarded["guarding's question"].per_period == pytest.approx(0.08)
    assert guarded["its answer"].data_bytes == 1


# Real frames between processes; udp_multicast carries remote frames


@pytest.fixture
def multicast_rig() -> Iterator[dict[str, Any]]:
    pytest.importorskip(
        "msgpack", reason="udp_multicast needs msgpack: pip install 'python-can[multicast]'"
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    bus: dict[str, Any] = {"channel": "239.74.163.2", "port": port, "hop_limit": 0}
    bus["interface"] = "udp_multicast"
    try:
        can.Bus(ignore_config=True, **bus).shutdown()
    except (can.CanError, OSError) as error:
        pytest.skip(f"this host has no multicast: {error}")
    settings: RigSettings = replace(SETTINGS, bus=bus)
    with spawn(settings):
        yield bus


@pytest.mark.wire
def test_on_a_real_bus_a_drive_stops_by_itself_when_its_master_falls_silent(
    multicast_rig: dict[str, Any],
) -> None:
    plain = VirtualRig("only its settings").canopen_settings(profile=GUARDED)
    settings = replace(plain, bus=multicast_rig)
    axis = CanopenAxis(settings)
    with PlainMaster(multicast_rig) as onlooker:
        axis.__enter__()
        start_ns = time.monotonic_ns()
        for slot in range(100):
            axis._clock.sleep_until(start_ns + slot * 8_000_000)
            axis.command(2.0, slot)
            axis.samples(start_ns + (slot + 1) * 8_000_000)
        assert not [event for event in axis.events() if event.fatal]
        while onlooker.bus.recv(0.0) is not None:
            pass  # what it overheard
        assert onlooker.sdo(DRIVE, 0x6041) & 0x6F == 0x27
        died_s = time.monotonic()
        while onlooker.sdo(DRIVE, 0x6041) & 0x6F in POWERED:
            assert time.monotonic() - died_s < 3.0
        took_s = time.monotonic() - died_s
        assert took_s < settings.drive.heartbeat_timeout_s + 0.5, "life time, ramp, a busy machine"
        assert abs(onlooker.sdo(DRIVE, 0x606C)) < 1000
        axis._line.bus.shutdown()


@pytest.mark.wire
def test_a_stranger_guards_our_slave(multicast_rig: dict[str, Any]) -> None:
    network = canopen.Network()
    network.connect(**multicast_rig)
    heard: list[int] = []
    try:
        node = network.add_node(DRIVE)
        node.sdo.download(0x100C, 0, struct.pack("<H", GUARD_MS))
        node.sdo.download(0x100D, 0, bytes([FACTOR]))
        network.subscribe(QUESTION, lambda _id, data, _time: heard.append(data[0]))
        node.nmt.start_node_guarding(0.05)
        end_s = time.monotonic() + 5.0
        while len(heard) < 6 and time.monotonic() < end_s:
            threading.Event().wait(0.01)
        node.nmt.stop_node_guarding()
        assert node.nmt.state == "PRE-OPERATIONAL"
        emergency = node.emcy.wait(0x8130, timeout=5.0)
    finally:
        network.disconnect()
    assert heard[:6] == [0x7F, 0xFF] * 3
    assert emergency is not None
    assert emergency.code == 0x8130
