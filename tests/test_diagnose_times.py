"""A logger's stamps that jitter, and rows that it never wrote."""

from dataclasses import replace

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.thinning import rows_to_a_command, thinned
from servo_bench.diagnosis.diagnose import diagnose
from servo_bench.diagnosis.reading.times import filled, jitter_s, on_even_times, with_rows_in_holes
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, commands, recorded

MODEL = Model(NOMINAL)
CHANNELS = ("velocity_command_rad_s", "motor_position_rad", "motor_torque_nm", "load_angle_rad")
SLOTS = 1600
LIKE_FRICTION = ("coulomb", "viscous", "stribeck", "pre_sliding", "missed_samples")


def logged(seed: int, model: Model = MODEL) -> Recording:
    """A run of a new command every row, as a CSV file has it: times and channels, no phases."""
    played = np.random.default_rng(seed).uniform(-4.0, 4.0, SLOTS)
    played[:80] = 0.0
    run = recorded(model, seed, played=played)
    channels = {name: run[name] for name in CHANNELS}
    return replace(run, channels={"t_s": PERIOD_S * np.arange(SLOTS), **channels})


def stamped(recording: Recording, seed: int, stray_s: float) -> Recording:
    late_s = np.abs(np.random.default_rng((seed, 2)).normal(0.0, stray_s, len(recording)))
    return replace(recording, channels={**recording.channels, "t_s": recording["t_s"] + late_s})


def less(recording: Recording, seed: int, share: float) -> Recording:
    """Without so many of its rows, but for the first and the last hundred."""
    kept = np.random.default_rng((seed, 3)).random(len(recording)) >= share
    kept[:100] = kept[-100:] = True
    channels = {name: values[kept] for name, values in recording.channels.items()}
    return replace(recording, channels=channels)


def test_an_even_clock_is_found_under_its_stamps() -> None:
    even = logged(31)
    found = on_even_times(stamped(even, 31, 4e-4))
    assert found is not None
    assert np.diff(found["t_s"]) == pytest.approx(PERIOD_S, abs=2e-8)
    assert jitter_s(stamped(even, 31, 4e-4), found) == pytest.approx(4e-4 * 0.603, rel=0.1)
    assert on_even_times(even) is None
    assert on_even_times(stamped(even, 31, 6e-3)) is None  # of which period each is, nobody knows
    holed = on_even_times(stamped(less(even, 31, 0.02), 31, 4e-4))
    assert holed is not None
    steps = np.diff(holed["t_s"]) / PERIOD_S
    assert steps == pytest.approx(np.rint(steps), abs=1e-5)


@pytest.mark.nightly
def test_stamps_that_stray_from_the_motion_are_not_believed() -> None:
    verdict = diagnose([stamped(logged(32), 32, 4e-4)], model=MODEL)
    assert verdict.verdict == "none", verdict.sentence
    assert any("by the even clock" in note for note in verdict.notes)
    assert verdict.error is not None
    assert verdict.error.after < 2.0 * verdict.error.noise_floor


@pytest.mark.nightly
def test_stamps_that_the_motion_follows_are_believed() -> None:
    """The rows really came unevenly, and every command with its row."""
    uneven = np.cumsum(np.random.default_rng(33).uniform(0.9, 1.1, SLOTS)) * PERIOD_S
    played = commands(33, SLOTS - 60)
    done = MODEL.simulate(played, np.diff(uneven, append=uneven[-1] + PERIOD_S))
    noise = 1e-4 * np.random.default_rng(34).standard_normal((2, SLOTS))
    channels = {
        "t_s": uneven,
        "velocity_command_rad_s": played,
        "motor_position_rad": done.motor_angle_rad + noise[0],
        "load_angle_rad": done.load_angle_rad + noise[1],
    }
    verdict = diagnose([replace(logged(33), channels=channels)], model=MODEL)
    assert verdict.verdict == "none", verdict.sentence
    assert not verdict.notes


def test_a_hole_gets_the_command_that_was_given_in_it() -> None:
    whole = logged(35)
    kept = np.ones(SLOTS, np.bool_)
    lost = np.arange(200, SLOTS - 100, 150)
    kept[lost] = False
    holed = replace(whole, channels={n: v[kept] for n, v in whole.channels.items()})
    rowed, holes = with_rows_in_holes(holed)
    assert list(holes) == lost.tolist()
    bridged = filled(rowed, holes, MODEL)
    given = whole["velocity_command_rad_s"][lost]
    assert bridged["t_s"] == pytest.approx(whole["t_s"])
    found = bridged["velocity_command_rad_s"]
    assert np.sqrt(np.mean((found[lost] - given) ** 2)) < 0.03
    assert (found[kept] == whole["velocity_command_rad_s"][kept]).all()
    assert with_rows_in_holes(whole) == (whole, ())


@pytest.mark.parametrize("rows", [3, 8, 15])
def test_a_hole_before_a_pause_is_answered_by_its_own_side(rows: int) -> None:
    whole = logged(37)
    kept = np.ones(SLOTS, np.bool_)
    kept[[400, 800 - rows]] = False
    t_s = whole["t_s"] + np.where(np.arange(SLOTS) >= 800, 5.0, 0.0)
    channels = {**whole.channels, "t_s": t_s}
    rowed, holes = with_rows_in_holes(
        replace(whole, channels={n: v[kept] for n, v in channels.items()})
    )
    found = filled(rowed, holes, MODEL)["velocity_command_rad_s"][list(holes)]
    given = whole["velocity_command_rad_s"][[400, 800 - rows]]
    assert found == pytest.approx(given, abs=0.1)


def test_a_command_that_other_rows_tell_is_not_guessed() -> None:
    """1 kHz, chips of 8 ms: of many chips the first row is missing, and of none all are."""
    played = np.repeat(np.random.default_rng(38).uniform(-4.0, 4.0, 400), 8)
    run = recorded(MODEL, 38, played=played, period_s=0.001)
    channels = {"t_s": 0.001 * np.arange(played.size), **{name: run[name] for name in CHANNELS}}
    whole = replace(run, channels=channels)
    kept = np.ones(played.size, np.bool_)
    kept[8 * np.arange(20, 380, 7)] = False
    rows = rows_to_a_command([whole])
    few = replace(whole, channels={n: v[kept] for n, v in channels.items()})
    found, expected = thinned(few, rows), thinned(whole, rows)
    assert (rows, rows_to_a_command([few])) == (8, 8)
    assert found["t_s"] == pytest.approx(expected["t_s"])
    command = "velocity_command_rad_s"
    assert (found[command] == expected[command]).all()
    assert np.isnan(found["motor_position_rad"]).sum() == (~kept).sum()
    assert with_rows_in_holes(found)[1] == ()


@pytest.mark.nightly
def test_missing_rows_cost_neither_a_verdict_nor_a_cause() -> None:
    """Nothing is made of them, of all that could be; and friction is told from what is like it."""
    rubbing = MODEL.with_effect("coulomb", torque_nm=0.012)
    for expected, model, only in (("none", MODEL, ()), ("named", rubbing, LIKE_FRICTION)):
        verdict = diagnose([less(logged(36, model), 36, 0.015)], model=MODEL, only=only)
        assert verdict.verdict == expected, verdict.sentence
        assert any("rows are missing" in note for note in verdict.notes)
        assert [cause.effect for cause in verdict.causes] == ["coulomb"][: len(verdict.causes)]
