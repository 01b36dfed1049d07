"""What should move and does not, and what may lag, jump back, or play without an alarm."""

import math
from dataclasses import replace
from pathlib import Path

import can
import numpy as np
import pytest

from drivers.canopen.settings import SecondEncoder
from drivers.plausible import DISAGREE, LAG_S, Plausibility
from tests.fake_canopen import FakeRig
from tests.virtual_rig import VirtualRig, install

COUNTS = 65536 / math.tau
PERIOD_S = 0.008
TRAVEL_RAD = math.radians(10.0)


def told(
    commanded_rad_s: np.ndarray,
    motor_rad: np.ndarray | None = None,
    load_rad: np.ndarray | None = None,
    missing: float = 0.0,
) -> dict[str, int]:
    """In which slot each alarm was first given; the motor follows ideally unless told otherwise."""
    heard: dict[str, int] = {}
    slot = 0
    plausible = Plausibility(
        TRAVEL_RAD, "drive 1", lambda kind, text: heard.setdefault(kind, slot) and None
    )
    random = np.random.default_rng(5)
    commanded_rad = np.concatenate(([0.0], np.cumsum(commanded_rad_s * PERIOD_S)))[:-1]
    motor = commanded_rad if motor_rad is None else motor_rad
    load = motor if load_rad is None else load_rad

    def counted(angle_rad: float) -> tuple[int, float] | None:
        if random.random() < missing:
            return None
        return round(angle_rad * COUNTS), float(angle_rad)

    for slot in range(len(commanded_rad)):
        plausible.look(
            slot * PERIOD_S, float(commanded_rad[slot]), counted(motor[slot]), counted(load[slot])
        )
    return heard


def chips(amplitude_rad_s: float, slots: int = 2000, seed: int = 1) -> np.ndarray:
    return amplitude_rad_s * np.random.default_rng(seed).choice([-1.0, 1.0], slots)


def follow(commanded_rad_s: np.ndarray, time_constant_s: float) -> np.ndarray:
    """The angle of a motor whose velocity follows with a first-order lag."""
    velocity, angle, angles = 0.0, 0.0, []
    blend = 1.0 - math.exp(-PERIOD_S / time_constant_s)
    for target in commanded_rad_s:
        angles.append(angle)
        velocity += blend * (target - velocity)
        angle += velocity * PERIOD_S
    return np.array(angles)


@pytest.mark.parametrize("amplitude_rad_s", [0.1, 2.6, 50.0])
@pytest.mark.parametrize("lag_s", [1e-4, 0.02, 0.5 * LAG_S])
@pytest.mark.parametrize("missing", [0.0, 0.1])
def test_an_honest_drive_may_lag_and_answers_may_be_lost(
    amplitude_rad_s: float, lag_s: float, missing: float
) -> None:
    command = chips(amplitude_rad_s)
    assert told(command, follow(command, lag_s), missing=missing) == {}


def test_steps_of_any_height_and_slow_drift_are_honest() -> None:
    command = np.repeat([0.0, 30.0, -30.0, 0.0], 400)
    drifting = follow(command, 0.02) + 0.05 * PERIOD_S * np.arange(command.size)
    assert told(command, drifting) == {}


def test_play_between_motor_and_load_is_honest() -> None:
    command = chips(2.6)
    motor = follow(command, 0.02)
    load, angle = [], 0.0
    for at in motor:
        angle = min(max(angle, at - 0.04), at + 0.04)
        load.append(angle)
    assert told(command, motor, np.array(load)) == {}


def test_a_load_that_stays_is_found_when_the_motor_has_turned_by_the_travel() -> None:
    command = np.full(200, 1.0)
    heard = told(command, load_rad=np.zeros(200))
    assert heard.pop("load does not move") == math.floor(TRAVEL_RAD / PERIOD_S) + 1
    assert heard == {"encoders disagree": math.floor(DISAGREE * TRAVEL_RAD / PERIOD_S) + 1}


@pytest.mark.parametrize("scale", [-1.0, 0.5, 2.0])
def test_encoders_that_count_the_same_shaft_differently_disagree(scale: float) -> None:
    command = np.full(200, 1.0)
    turning = np.cumsum(command) * PERIOD_S
    heard = told(command, motor_rad=turning, load_rad=scale * turning)
    assert set(heard) == {"encoders disagree"}
    least_s = DISAGREE * TRAVEL_RAD / abs(scale - 1.0)
    assert heard["encoders disagree"] == pytest.approx(least_s / PERIOD_S, abs=2)


def test_a_motor_encoder_that_stays_is_found_by_load_and_command() -> None:
    command = np.full(200, 1.0)
    turning = np.cumsum(command) * PERIOD_S
    heard = told(command, motor_rad=np.zeros(200), load_rad=turning)
    assert set(heard) == {"motor encoder stuck", "motor does not move", "encoders disagree"}
    assert heard.pop("encoders disagree") > TRAVEL_RAD / PERIOD_S + 2
    assert max(heard.values()) <= TRAVEL_RAD / PERIOD_S + 2


def test_a_motor_that_goes_on_with_an_old_command_is_found() -> None:
    command = chips(2.6)
    heard = told(command, motor_rad=2.6 * PERIOD_S * np.arange(command.size))
    assert set(heard) == {"motor does not follow"}
    assert heard["motor does not follow"] < 1.0 / PERIOD_S


def test_the_drives_second_encoder_is_the_load_of_a_rig_without_another() -> None:
    install()
    world = VirtualRig("second encoder")
    second = SecondEncoder(counts_per_revolution=65536, direction=-1)
    plain = world.canopen_settings()
    drive = replace(plain.drive, second_encoder=second)
    # this rig's encoder counts forwards: told to be mounted backwards, it goes another way
    settings = replace(plain, drive=drive, encoder=None, stuck_travel_rad=10.0)
    samples = []
    with world.axis(settings) as axis:
        for slot in range(100):
            axis.command(2.0, slot)
            samples += axis.samples(world.now_ns + 8_000_000)
            world.pass_until(world.now_ns + 8_000_000)
        assert [event.kind for event in axis.events() if event.fatal] == []
    last = samples[-1]
    assert last.motor_position_rad is not None
    assert last.load_angle_rad is not None
    gap_rad = world.settings.nominal.backlash_gap_rad
    assert last.motor_position_rad > 1.0
    assert abs(-last.load_angle_rad - last.motor_position_rad) <= gap_rad
    assert last.motor_current_a is not None
    assert last.motor_torque_nm == pytest.approx(
        last.motor_current_a * world.settings.nominal.torque_constant_nm_per_a, abs=2e-3
    )


def test_an_error_frame_of_the_adapter_is_told_and_bus_off_is_fatal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = FakeRig(tmp_path, monkeypatch)
    with fake.axis() as axis:
        for classes in (0x04, 0x08, 0x08, 0x40):
            frame = can.Message(arbitration_id=classes, is_error_frame=True, data=bytes(8))
            fake.world.waiting.append(frame)
        axis.command(0.0, 0)
        axis.samples(fake.world.now_ns + 8_000_000)
        events = axis.events()
    assert [(event.kind, event.fatal) for event in events] == [
        ("bus errors", False),
        ("bus errors", False),
        ("bus-off", True),
    ]
    assert "controller" in events[0].text
    assert "protocol violation" in events[1].text
