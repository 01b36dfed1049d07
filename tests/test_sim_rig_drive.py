"""The CiA 402 drive of the software rig, in this process, on a clock that the test winds."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_rig.canopen.cia402 import State, next_state
from sim_rig.model import Model
from sim_rig.plant import PlantOutputs
from tests.wire import (
    COUNTS,
    DRIVE,
    DRIVE_MOTION,
    DRIVE_STATE,
    LOAD,
    MASTER,
    NOMINAL,
    RPDO,
    STATE_MASK,
    LocalRig,
    SdoAbortError,
    local_rig,
)

RAD = math.tau / COUNTS
OFF, READY, ON, ENABLED = 0x40, 0x21, 0x23, 0x27
QUICK_STOP, REACTING, FAULT = 0x07, 0x0F, 0x08
POWERED = {ENABLED, QUICK_STOP, REACTING}

LEGAL = {
    OFF: {READY},
    READY: {ON, ENABLED, OFF},
    ON: {ENABLED, READY, OFF},
    ENABLED: {ON, READY, OFF, QUICK_STOP, REACTING},
    QUICK_STOP: {OFF, ENABLED, REACTING},
    REACTING: {FAULT},
    FAULT: {OFF},
}
"""CiA 402-2, figure of the power state machine; 3 and 4 may follow at once."""

EMCY, HEARTBEAT = 0x080 + DRIVE, 0x700 + MASTER


class Spy:
    """A plant that notes what it is told and follows at once."""

    def __init__(self) -> None:
        self.told: list[tuple[float | None, float]] = []
        self.velocity_rad_s = self.angle_rad = 0.0

    def advance(self, velocity_command_rad_s: float | None, duration_s: float) -> None:
        self.told.append((velocity_command_rad_s, duration_s))
        self.velocity_rad_s = velocity_command_rad_s or 0.0
        self.angle_rad += self.velocity_rad_s * duration_s

    def outputs(self) -> PlantOutputs:
        return PlantOutputs(self.angle_rad, self.velocity_rad_s, 0.0, self.angle_rad)

    def take(self) -> list[tuple[float | None, float]]:
        told, self.told = self.told, []
        return told


def state(rig: LocalRig) -> int:
    return rig.sdo(DRIVE, 0x6041) & STATE_MASK & (0x4F if rig.sdo(DRIVE, 0x6041) & 8 else 0x6F)


def watched(rig: LocalRig, timeout_ms: int = 100, reaction: int = 3) -> None:
    """Have the drive watch the master's heartbeat, and send the first."""
    rig.sdo(DRIVE, 0x1016, 1, MASTER << 16 | timeout_ms)
    rig.sdo(DRIVE, 0x6007, 0, reaction, 2)
    rig.send(HEARTBEAT, b"\x05")


# the table


@given(st.sampled_from(list(State)), st.integers(0, 0xFFFF), st.integers(0, 0xFFFF), st.booleans())
def test_every_controlword_leads_to_a_legal_state(
    before: State, word: int, last: int, holds: bool
) -> None:
    after = next_state(before, word, last, quick_stop_holds=holds)
    assert after == before or after in LEGAL[before]
    assert after != State.FAULT_REACTION_ACTIVE or before == after
    if before is State.FAULT and after != before:
        assert word & 0x80
        assert not last & 0x80


@pytest.mark.parametrize(
    ("before", "word", "after"),
    [
        (OFF, 0x06, READY),
        (OFF, 0x07, OFF),
        (OFF, 0x0F, OFF),
        (READY, 0x07, ON),
        (ON, 0x0F, ENABLED),
        (ENABLED, 0x07, ON),
        (ENABLED, 0x06, READY),
        (ENABLED, 0x02, QUICK_STOP),
        (ENABLED, 0x00, OFF),
        (READY, 0x02, OFF),
        (QUICK_STOP, 0x00, OFF),
        (QUICK_STOP, 0x06, QUICK_STOP),
        (FAULT, 0x80, OFF),
        (FAULT, 0x0F, FAULT),
        (REACTING, 0x80, REACTING),
    ],
)
def test_the_standards_transitions(before: int, word: int, after: int) -> None:
    assert next_state(State(before), word, 0, quick_stop_holds=False) == after


# motion


steps = st.lists(
    st.tuples(
        st.sampled_from([0x00, 0x02, 0x06, 0x07, 0x0F, 0x0F, 0x10F, 0x80, 0x8F])
        | st.integers(0, 0x1FF),
        st.integers(-(2**18), 2**18),
        st.sampled_from([1000, 8000, 60_000, 250_000]),
        st.booleans(),
    ),
    max_size=25,
)


@settings(max_examples=60, deadline=None)
@given(steps, st.sampled_from([1, 2, 5, 6]), st.sampled_from([0, 1, 2, 3]), st.sampled_from([3, 9]))
def test_it_moves_only_when_enabled_or_stopping(
    script: list[tuple[int, int, int, bool]], option: int, reaction: int, mode: int
) -> None:
    plant = Spy()
    rig = local_rig(plant)
    rig.sdo(DRIVE, 0x605A, 0, option, 2)
    watched(rig, reaction=reaction)
    rig.sdo(DRIVE, 0x6060, 0, mode, 1)
    rig.send(0, bytes([1, 0]))
    before = state(rig)
    for word, target, us, beats in [(6, 0, 1000, True), (15, 0, 1000, True), *script]:
        plant.take()
        if beats:
            rig.send(HEARTBEAT, b"\x05")
        rig.cycle(word, target, us=0)
        assert not plant.take(), "no time has passed"
        entered = state(rig)
        assert entered in LEGAL
        assert entered == before or entered in LEGAL[before]
        rig.wait(us)
        before = state(rig)
        told = [command for command, _ in plant.take()]
        if entered not in POWERED:
            assert set(told) <= {None}
        if before not in POWERED:
            assert not told or rig.sdo(DRIVE, 0x606B) == 0
        if entered in (QUICK_STOP, REACTING) and before == entered:
            speeds = [abs(command) for command in told if command is not None]
            assert speeds == sorted(speeds, reverse=True)


def test_cyclic_velocity_acts_from_its_sync_and_is_sampled_before() -> None:
    rig = local_rig()
    rig.enable()
    commands = np.random.default_rng(8).choice([-30_000, 30_000], 200)
    durations_us = 8000 + np.random.default_rng(9).integers(-3000, 3000, 200)
    motor, torque, velocity, load, stamps = [], [], [], [], []
    for command, us in zip(commands.tolist(), durations_us.tolist(), strict=True):
        rig.send(RPDO, struct.pack("<Hi", 0x0F, command))
        rig.sent.clear()
        rig.send(0x80)
        frames = dict(rig.sent)
        position, per_mille = struct.unpack_from("<ih", frames[DRIVE_STATE], 2)
        speed, stamp = struct.unpack("<iI", frames[DRIVE_MOTION])
        angle, encoder_stamp = struct.unpack("<II", frames[LOAD])
        assert stamp == encoder_stamp == rig.now_us % 2**32
        motor.append(position)
        torque.append(per_mille)
        velocity.append(speed)
        load.append(angle)
        stamps.append(rig.now_us)
        rig.now_us += us
    truth = Model(NOMINAL).simulate(commands * RAD, durations_us * 1e-6)
    assert np.abs(np.array(motor) * RAD - truth.motor_angle_rad).max() <= 0.5001 * RAD
    wrapped = (np.array(load) + 2**27) % 2**28 - 2**27
    assert np.abs(wrapped * RAD - truth.load_angle_rad).max() <= 0.5001 * RAD
    assert np.abs(np.array(velocity) - truth.motor_velocity_rad_s / RAD).max() <= 0.5001
    expected = truth.motor_current_a * NOMINAL.torque_constant_nm_per_a / 0.64 * 1000
    assert np.abs(np.array(torque) - expected).max() <= 0.5001
    assert np.ptp(torque) > 10


def test_the_last_set_point_before_a_sync_wins() -> None:
    plant = Spy()
    rig = local_rig(plant)
    rig.enable()
    plant.take()
    rig.send(RPDO, struct.pack("<Hi", 0x0F, 1000))
    rig.wait(2000)
    rig.cycle(0x0F, 2000)
    rig.cycle(0x0F, 2000)
    assert [c for c, _ in plant.take() if c] == pytest.approx([2000 * RAD])


def test_cyclic_mode_says_that_it_follows() -> None:
    rig = local_rig()
    rig.enable(mode=9)
    assert rig.cycle(0x0F) & 1 << 12
    rig.cycle(0x02)
    assert not rig.cycle(0x02) & 1 << 12


def test_profile_velocity_ramps() -> None:
    plant = Spy()
    rig = local_rig(plant)
    rig.sdo(DRIVE, 0x6083, 0, 1_000_000)
    rig.sdo(DRIVE, 0x6084, 0, 2_000_000)
    rig.enable(mode=3)
    plant.take()
    rig.cycle(0x0F, 50_000)
    assert not rig.cycle(0x0F, 50_000) & 1 << 10, "target reached before it was"
    rig.wait(100_000)
    speeds = np.array([c for c, _ in plant.take()[1:]]) / RAD
    assert speeds[:50] == pytest.approx(np.arange(1, 51) * 1000.0)
    assert set(speeds[50:].round()) == {50_000.0}
    assert rig.cycle(0x0F, 50_000) & 1 << 10
    rig.cycle(0x0F, 0)
    rig.wait(100_000)
    speeds = np.array([c for c, _ in plant.take()[1:]]) / RAD
    assert speeds[1:26] == pytest.approx(np.arange(24, -1, -1) * 2000.0)


def test_profile_velocity_is_limited_and_says_so() -> None:
    rig = local_rig(Spy())
    rig.sdo(DRIVE, 0x607F, 0, 10_000)
    rig.enable(mode=3)
    rig.cycle(0x0F, -50_000)
    rig.wait(100_000)
    status = rig.cycle(0x0F, -50_000)
    assert status & 1 << 11
    assert rig.sdo(DRIVE, 0x606B) == 2**32 - 10_000


def test_halt_stops_along_the_ramp_and_releases() -> None:
    rig = local_rig(Spy())
    rig.enable(mode=3)
    rig.cycle(0x0F, 50_000)
    rig.wait(50_000)
    rig.cycle(0x10F, 50_000)
    rig.wait(50_000)
    assert rig.sdo(DRIVE, 0x606B) == 0
    assert state(rig) == ENABLED
    rig.cycle(0x0F, 50_000)
    rig.wait(50_000)
    assert rig.sdo(DRIVE, 0x606B) == 50_000


@pytest.mark.parametrize(("option", "end"), [(1, OFF), (2, OFF), (5, QUICK_STOP), (6, QUICK_STOP)])
def test_quick_stop_options(option: int, end: int) -> None:
    rig = local_rig()
    rig.sdo(DRIVE, 0x605A, 0, option, 2)
    rig.enable()
    for _ in range(50):
        rig.cycle(0x0F, 60_000)
    assert abs(rig.sdo(DRIVE, 0x606C) - 60_000) < 600
    rig.cycle(0x02, 60_000)
    assert state(rig) == QUICK_STOP
    rig.wait(2_000_000)
    assert state(rig) == end
    position = rig.sdo(DRIVE, 0x6064)
    rig.wait(1_000_000)
    assert abs(rig.sdo(DRIVE, 0x6064) - position) <= 1
    rig.cycle(0x0F, 0)
    assert state(rig) == (ENABLED if end == QUICK_STOP else OFF)


def test_quick_stop_takes_the_ramp_of_its_option() -> None:
    lasting = {}
    for option in (1, 2):
        plant = Spy()
        rig = local_rig(plant)
        rig.sdo(DRIVE, 0x605A, 0, option, 2)
        rig.sdo(DRIVE, 0x6084, 0, 500_000)
        rig.sdo(DRIVE, 0x6085, 0, 5_000_000)
        rig.enable()
        rig.cycle(0x0F, 50_000)
        rig.cycle(0x02)
        plant.take()
        rig.wait(200_000)
        lasting[option] = sum(s for c, s in plant.take() if c)
    assert lasting[1] == pytest.approx(0.1, abs=0.002)
    assert lasting[2] == pytest.approx(0.01, abs=0.002)


def test_disable_voltage_lets_it_coast() -> None:
    rig = local_rig()
    rig.enable()
    for _ in range(50):
        rig.cycle(0x0F, 60_000)
    rig.cycle(0x00)
    speed = rig.sdo(DRIVE, 0x606C)
    rig.wait(500_000)
    assert rig.sdo(DRIVE, 0x606C) == speed > 50_000
    assert rig.sdo(DRIVE, 0x6077) == 0


def test_the_position_runs_over_as_integer32() -> None:
    plant = Spy()
    rig = local_rig(plant)
    plant.angle_rad = (2**31 - 10) * RAD
    assert rig.sdo(DRIVE, 0x6064) == 2**31 - 10
    plant.angle_rad += 20 * RAD
    assert rig.sdo(DRIVE, 0x6064) == 2**32 - (2**31 - 10)


# supervision


@pytest.mark.parametrize(
    ("reaction", "end", "stands"),
    [(0, ENABLED, False), (1, FAULT, True), (2, OFF, False), (3, OFF, True)],
)
def test_a_silent_master(reaction: int, end: int, stands: bool) -> None:
    rig = local_rig()
    watched(rig, 100, reaction)
    rig.enable()
    for _ in range(12):
        rig.send(HEARTBEAT, b"\x05")
        rig.cycle(0x0F, 60_000)
    rig.sent.clear()
    rig.wait(60_000)
    assert not rig.take(EMCY), "too early"
    rig.wait(2_000_000)
    (emergency,) = rig.take(EMCY)
    code, register = struct.unpack_from("<HB", emergency)
    assert (code, register & 0x11) == (0x8130, 0x11)
    assert state(rig) == end
    assert (rig.sdo(DRIVE, 0x606C) == 0) is stands
    assert rig.sdo(DRIVE, 0x1003, 1) == 0x8130


def test_a_fault_is_reset_by_a_rising_edge_only() -> None:
    rig = local_rig()
    watched(rig, 100, reaction=1)
    rig.enable()
    rig.wait(1_000_000)
    assert state(rig) == FAULT
    assert rig.sdo(DRIVE, 0x603F) == 0x8130
    for word in (0x0F, 0x06, 0x00):
        rig.cycle(word)
        assert state(rig) == FAULT
    rig.send(HEARTBEAT, b"\x05")
    rig.cycle(0x80)
    assert state(rig) == OFF
    assert rig.sdo(DRIVE, 0x603F) == rig.sdo(DRIVE, 0x1001) == 0


def test_the_error_is_over_when_the_master_beats_again() -> None:
    rig = local_rig()
    watched(rig)
    rig.wait(200_000)
    rig.sent.clear()
    rig.send(HEARTBEAT, b"\x05")
    (emergency,) = rig.take(EMCY)
    assert emergency == bytes(8)


def test_the_watch_begins_with_the_first_beat() -> None:
    rig = local_rig()
    rig.sdo(DRIVE, 0x1016, 1, MASTER << 16 | 100)
    rig.wait(1_000_000)
    assert not rig.take(EMCY)


def test_a_stopped_node_stops_its_axis() -> None:
    rig = local_rig()
    rig.enable()
    for _ in range(30):
        rig.cycle(0x0F, 60_000)
    rig.send(0, bytes([2, DRIVE]))
    rig.wait(1_500_000)
    rig.send(0, bytes([128, DRIVE]))
    assert state(rig) == OFF
    assert rig.sdo(DRIVE, 0x606C) == 0


def test_a_reset_switches_off_but_does_not_brake() -> None:
    rig = local_rig()
    rig.enable()
    for _ in range(50):
        rig.cycle(0x0F, 60_000)
    rig.send(0, bytes([129, DRIVE]))
    assert state(rig) == OFF
    assert rig.sdo(DRIVE, 0x606C) > 50_000
    assert rig.sdo(DRIVE, 0x60FF) == 0


# objects


@pytest.mark.parametrize(
    ("index", "subindex", "value", "size", "code"),
    [
        (0x60C2, 1, 0, 1, 0x06090030),
        (0x60C2, 1, 101, 1, 0x06090030),
        (0x60C2, 2, -4, 1, 0x06090030),
        (0x605A, 0, 3, 2, 0x06090030),
        (0x6060, 0, 8, 1, 0x06090030),
        (0x6007, 0, 4, 2, 0x06090031),
        (0x6083, 0, 0, 4, 0x06090032),
        (0x6041, 0, 0, 2, 0x06010002),
        (0x6076, 0, 1, 4, 0x06010002),
        (0x6040, 0, 6, 4, 0x06070012),
        (0x60FF, 0, 6, 2, 0x06070013),
    ],
)
def test_writes_that_are_refused(
    index: int, subindex: int, value: int, size: int, code: int
) -> None:
    rig = local_rig()
    with pytest.raises(SdoAbortError) as refused:
        rig.sdo(DRIVE, index, subindex, value, size)
    assert refused.value.code == code


def test_what_the_settings_say_can_be_read() -> None:
    rig = local_rig(motor_counts_per_revolution=10_000, rated_torque_nm=1.27)
    assert rig.sdo(DRIVE, 0x608F, 1) == 10_000
    assert rig.sdo(DRIVE, 0x6076) == 1270
    assert rig.sdo(DRIVE, 0x6075) == round(1.27 / 0.03606 * 1000)
    assert rig.sdo(DRIVE, 0x6502) == 1 << 2 | 1 << 8


def test_sensor_noise_is_what_was_asked_for_and_repeats() -> None:
    def positions(seed: int) -> list[int]:
        rig = local_rig(Spy(), motor_encoder_noise_rad=20 * RAD, seed=seed)
        raw = [rig.sdo(DRIVE, 0x6064) for _ in range(2000)]
        return [value - 2**32 if value >> 31 else value for value in raw]

    first = positions(1)
    assert positions(1) == first != positions(2)
    assert np.std(first) == pytest.approx(20.0, rel=0.1)
    assert np.mean(first) == pytest.approx(0.0, abs=2.0)
