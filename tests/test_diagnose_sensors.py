"""A channel that is counted the other way, or read at another time, is told in words."""

from dataclasses import replace

import numpy as np
import pytest

from servo_bench.diagnosis.allowance import SCALES
from servo_bench.diagnosis.comparison import compare
from servo_bench.diagnosis.rows import Array
from servo_bench.diagnosis.sensors import misread
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, recorded

MODEL = Model(NOMINAL)
RUBBING = MODEL.with_effect("coulomb", torque_nm=0.01)
SLOTS = 1500


def logged(seed: int, **changed: Array) -> Recording:
    """What a logger has of a rig that rubs more than its file says."""
    played = np.random.default_rng(seed).uniform(-4.0, 4.0, SLOTS)
    run = recorded(RUBBING, seed, played=played)
    names = ("velocity_command_rad_s", "motor_position_rad", "motor_torque_nm", "load_angle_rad")
    channels = {"t_s": PERIOD_S * np.arange(SLOTS), **{name: run[name] for name in names}}
    return replace(run, channels=channels)


def with_channel(recording: Recording, name: str, values: Array) -> Recording:
    return replace(recording, channels={**recording.channels, name: values})


def told(recording: Recording) -> list[str]:
    return list(misread(compare(recording, MODEL, scales=SCALES), MODEL, RUBBING))


def late(values: Array, rows: int) -> Array:
    return np.concatenate([np.full(rows, values[0]), values[:-rows]])


def test_channels_that_are_the_rigs_own_are_not_spoken_of() -> None:
    assert told(logged(41)) == []


@pytest.mark.parametrize("scale", [-1.0, 0.1, 2.0])
def test_an_angle_of_another_size_or_sign_is_told(scale: float) -> None:
    run = logged(42)
    (sentence,) = told(with_channel(run, "load_angle_rad", scale * run["load_angle_rad"]))
    assert sentence.startswith("The load's angle moves")
    assert float(sentence.split()[4]) == pytest.approx(scale, rel=0.12)


@pytest.mark.parametrize(
    ("channel", "role", "rows"),
    [
        ("load_angle_rad", "load_sampled", 1),
        ("motor_position_rad", "motor_sampled", 2),
        *(("motor_torque_nm", "current_sampled", rows) for rows in (1, 2, 3)),
    ],
)
def test_a_channel_that_comes_late_is_told_and_the_map_can_say_so(
    channel: str, role: str, rows: int
) -> None:
    run = logged(43)
    behind = with_channel(run, channel, late(np.asarray(run[channel]), rows))
    (sentence,) = told(behind)
    assert f'role = "{role}", value = {-8 * rows}, unit = "ms"' in sentence
    said = with_channel(behind, f"{role}_s", np.full(SLOTS, -rows * PERIOD_S))
    if role == "motor_sampled":
        said = with_channel(said, "current_sampled_s", np.zeros(SLOTS))
    assert told(said) == []
    seen = compare(said, RUBBING)
    left = seen.rms(seen.errors(RUBBING), seen.seen) / [signal.floor for signal in seen.signals]
    assert left.max() < 2.0


def test_a_rig_whose_drive_answers_late_for_all_of_its_own_is_right_as_it_was_told() -> None:
    run = logged(44)
    for channel in ("motor_position_rad", "motor_torque_nm", "load_angle_rad"):
        run = with_channel(run, channel, late(np.asarray(run[channel]), 1))
    for role in ("motor_sampled_s", "load_sampled_s"):
        run = with_channel(run, role, np.full(SLOTS, -PERIOD_S))
    assert told(run) == []
