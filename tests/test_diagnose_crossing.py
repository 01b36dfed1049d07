"""A clock that falls behind until samples see the next command: when, and that it is named."""

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import evidence_of
from servo_bench.diagnosis.judging.judgement import verdict_of
from servo_bench.diagnosis.reading.crossing import crossing_s
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, commands, recorded, with_channels
from tests.trial import run_trial
from tests.trials.drawing import Question

MODEL = Model(NOMINAL)
SLOTS, PERIOD_S = 1500, 0.008
DELAY_S = 8e-5


def skewed(seed: int, skew_fraction: float, delay_s: float = DELAY_S) -> Recording:
    rig = MODEL.with_effect("clock_skew", skew_fraction=skew_fraction)
    return recorded(rig.with_effect("transport_delay", delay_s=delay_s), seed, slots=SLOTS)


def crossed(recording: Recording, model: Model = MODEL) -> float | None:
    return crossing_s(evidence_of([recording], MODEL).fitted[0], model)


@pytest.mark.parametrize("after_s", [2.0, 5.0, 9.0])
def test_it_is_crossed_when_the_delay_is_used_up(after_s: float) -> None:
    found = crossed(skewed(1, -DELAY_S / after_s))
    assert found == pytest.approx(after_s, abs=4 * PERIOD_S)


@pytest.mark.parametrize("after_s", [2.0, 5.0])
def test_a_drive_that_shows_two_thirds_of_a_jump_at_first_is_crossed_too(after_s: float) -> None:
    """Its current's first tick comes before the sample, and its next one after it."""
    walks, stands = skewed(7, -DELAY_S / after_s), skewed(7, 0.0)
    torque = [np.asarray(r["motor_torque_nm"]) for r in (walks, stands)]
    between = with_channels(walks, motor_torque_nm=0.65 * torque[0] + 0.35 * torque[1])
    assert crossed(between) == pytest.approx(after_s, abs=4 * PERIOD_S)


@pytest.mark.parametrize("stairs_s", [(2.0, 9.0), (3.0, 5.0), (6.0, 10.5)])
def test_what_a_clock_that_walks_by_little_crosses_in_stairs(stairs_s: tuple[float, float]) -> None:
    """A half of every jump shows from the one on, and all of it from the other on: long after a
    third of the record the share is neither none nor all."""
    one, other = (skewed(8, -DELAY_S / after_s) for after_s in stairs_s)
    torque = [np.asarray(r["motor_torque_nm"]) for r in (one, other)]
    found = crossed(with_channels(one, motor_torque_nm=0.5 * torque[0] + 0.5 * torque[1]))
    assert found is not None
    assert min(abs(found - stair_s) for stair_s in stairs_s) < 4 * PERIOD_S


@pytest.mark.parametrize("share", [0.15, 0.25])
@pytest.mark.parametrize("torque_nm", [8e-3, 2e-2])
def test_friction_that_nobody_modelled_is_no_clock_where_the_amplitude_changes(
    share: float, torque_nm: float
) -> None:
    """A jump comes after others: of a small first half friction shows as less than none of it."""
    played = commands(9, SLOTS)
    played[: played.size // 2] *= share
    rubs = MODEL.with_effect("coulomb", torque_nm=torque_nm)
    assert crossed(recorded(rubs, 9, played=played)) is None


@pytest.mark.parametrize("seed", range(6))
def test_where_commands_fade_out_the_rest_has_no_say(seed: int) -> None:
    """Its jumps are many and have no energy: a share of them is noise, or none over none."""
    fading = 2.0 * 0.97 ** np.arange(1200)
    played = np.concatenate((commands(seed, 60), fading))
    assert crossed(recorded(MODEL, seed, played=played)) is None


@pytest.mark.parametrize("skew_fraction", [2e-5, 0.0, -2e-6])
def test_a_clock_that_crosses_nothing(skew_fraction: float) -> None:
    assert crossed(skewed(2, skew_fraction)) is None


def test_samples_that_see_the_next_command_from_the_start_are_no_clocks_doing() -> None:
    assert crossed(skewed(3, -1e-6, delay_s=0.0)) is None


def test_without_current_nothing_is_said() -> None:
    recording = skewed(4, -DELAY_S / 4.0)
    hidden = with_channels(recording, motor_torque_nm=np.full(len(recording), np.nan))
    assert crossed(hidden) is None


@pytest.mark.parametrize("wrong", [0.85, 1.15])
def test_a_wrong_inertia_is_not_taken_for_it_and_does_not_hide_it(wrong: float) -> None:
    other = MODEL.with_effect("inertia_error", error_fraction=wrong - 1.0)
    assert crossed(skewed(5, 0.0), other) is None
    assert crossed(skewed(5, -DELAY_S / 5.0), other) == pytest.approx(5.0, abs=8 * PERIOD_S)


@pytest.mark.nightly
@pytest.mark.parametrize("after_s", [3.0, 8.0])
def test_the_skew_is_named_with_its_size(after_s: float) -> None:
    skew = -DELAY_S / after_s
    verdict = verdict_of(find_causes([skewed(6, skew)], MODEL))
    assert verdict.names == ("clock_skew",)
    (cause,) = verdict.causes
    assert cause.parameters["skew_fraction"].value == pytest.approx(skew, rel=0.2)


@pytest.mark.nightly
def test_a_clock_whose_jumps_show_a_drives_tick_after_it_crossed_is_named() -> None:
    """In the independent plant, whose drive has ticks: a good part of a jump shows after 8 s, where
    -22e-6 had crossed at 3."""
    line = run_trial(Question(seed=5402500, effect="clock_skew"))
    assert line["failure"] == ""
    assert [named["effect"] for named in line["score"]["named"]] == ["clock_skew"]
    (number,) = (m for m in line["score"]["measured"] if m["parameter"] == "skew_fraction")
    assert number["covered"]
    assert abs(number["relative_error"]) < 0.1
