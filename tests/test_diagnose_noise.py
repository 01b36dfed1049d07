"""What a sensor's noise is taken for, where no phase says when the rig stood still.

Measured data from elsewhere have a clock, commands and sensors, and no phases: on them the same
noise must be found, else a simulation may miss what it may not.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.diagnosis.comparing.comparison import compare
from servo_bench.diagnosis.comparing.evidence import quick_evidence
from servo_bench.diagnosis.comparing.noise import floor_of
from servo_bench.diagnosis.comparing.rows import rows_of
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import (
    COUNTS,
    NOMINAL,
    PERIOD_S,
    STANDSTILL,
    commands,
    nominal_with,
    recorded,
    rows,
    with_channels,
)

MODEL = Model(NOMINAL)
COUNT_RAD = math.tau / COUNTS
WHITE_RAD = COUNT_RAD * math.sqrt(1.0 + 1.0 / 12.0)
"""One count of white noise, and the rounding to counts."""


def from_elsewhere(recording: Recording, first: int = 0) -> Recording:
    """Only what a logger of another bench has, from this row on."""
    kept = rows(recording, np.arange(first, len(recording)))
    channels = {n: v for n, v in kept.channels.items() if n not in ("phase", "slot", "asked_ns")}
    return replace(kept, channels={**channels, "t_s": PERIOD_S * np.arange(len(kept))})


def load_floor_rad(recording: Recording, model: Model = MODEL) -> float:
    """Of the load's increments, per end."""
    signals = compare(recording, model, "loop").signals
    floor = next(s.floor for s in signals if s.channel == "load_angle_rad")
    return floor * PERIOD_S / math.sqrt(2.0)


def stopping(seed: int) -> Recording:
    played = np.concatenate((commands(seed, 600)[STANDSTILL:], np.zeros(150)))
    return from_elsewhere(recorded(MODEL, seed, played=played))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_rest_tells_the_noise_to_a_simulation_that_is_wrong(seed: int) -> None:
    wrong = Model(nominal_with(inertia_kg_m2=1.6, backlash_gap_rad=0.5))
    at_rest = load_floor_rad(stopping(seed), wrong)
    assert at_rest == pytest.approx(WHITE_RAD, rel=0.25)
    never = from_elsewhere(recorded(MODEL, seed), STANDSTILL + 7)
    assert load_floor_rad(never, wrong) > 2.0 * WHITE_RAD


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_rest_over_the_joint_of_two_runs_is_none(seed: int) -> None:
    one, other = stopping(seed), from_elsewhere(recorded(MODEL, seed + 10))
    moved = {**other.channels, "load_angle_rad": other["load_angle_rad"] + 0.5}
    joined = {n: np.concatenate((one[n], moved[n])) for n in one.channels}
    joined["run"] = np.repeat([0, 1], [len(one), len(other)])
    both = replace(one, channels=joined)
    assert load_floor_rad(both) == pytest.approx(WHITE_RAD, rel=0.25)


def test_a_drive_that_is_off_tells_nothing_of_its_torques_noise() -> None:
    recording = stopping(5)
    torque = np.where(np.arange(len(recording)) < 600, recording["motor_torque_nm"], 0.0)
    signals = compare(with_channels(recording, motor_torque_nm=torque), MODEL, "loop").signals
    floor = next(s.floor for s in signals if s.channel == "motor_torque_nm")
    assert floor == pytest.approx(0.2e-3, rel=0.3)


def test_a_channel_that_comes_now_and_then_has_the_same_noise() -> None:
    recording = from_elsewhere(recorded(MODEL, 3))
    angle = recording["load_angle_rad"].copy()
    angle[1::2] = np.nan
    floor = floor_of(
        rows_of(with_channels(recording, load_angle_rad=angle)),
        "load_angle_rad",
        increments=False,
        simulated=np.asarray(recording["load_angle_rad"]) - white(len(recording)),
    )
    assert floor == pytest.approx(COUNT_RAD, rel=0.25)


def white(rows: int) -> NDArray[np.float64]:
    return np.asarray(COUNT_RAD * np.random.default_rng(8).standard_normal(rows))


@pytest.mark.parametrize("increments", [False, True])
def test_words_that_interference_spoils_at_rest_are_no_noise(*, increments: bool) -> None:
    """Of a hundred that stood still two bursts of three: the floor is that of the others."""
    run = recorded(MODEL, 9)
    angle = run["load_angle_rad"].copy()
    for first in (10, 60):
        angle[first : first + 3] += 0.1
    spoilt = rows_of(with_channels(run, load_angle_rad=angle))
    clean = floor_of(rows_of(run), "load_angle_rad", increments=increments)
    floor = floor_of(spoilt, "load_angle_rad", increments=increments)
    assert floor == pytest.approx(clean, rel=0.1)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_without_a_rest_what_a_simulation_leaves_tells_the_noise(seed: int) -> None:
    moving = from_elsewhere(recorded(MODEL, seed), STANDSTILL + 7)
    assert load_floor_rad(moving) == pytest.approx(WHITE_RAD, rel=0.25)
    alone = floor_of(rows_of(moving), "load_angle_rad", increments=False)
    assert alone > 5.0 * WHITE_RAD


def test_a_beginning_is_judged_by_what_the_whole_keeps_back() -> None:
    whole = from_elsewhere(recorded(MODEL, 4, slots=2000))
    quick = quick_evidence([whole], MODEL, 600)
    (fitted,), (judging,) = quick.fitted, quick.judging
    assert len(fitted.source.rows.recording) == 600
    last = np.flatnonzero(judging.held_out)
    assert last[0] > 1400
    assert last[-1] == len(whole) - 2


@pytest.mark.long
def test_a_gap_is_found_in_data_from_elsewhere_as_in_a_run() -> None:
    hidden = MODEL.with_effect("backlash_width", change_rad=3e-3)
    recording = from_elsewhere(recorded(hidden, 6, slots=900), STANDSTILL + 20)
    found = find_causes([recording], MODEL, only=("backlash_width",))
    assert [n.effect for n in found.named] == ["backlash_width"]
    gap = found.final.model.effects["backlash_width"].change_rad
    assert gap == pytest.approx(3e-3, rel=0.05)
