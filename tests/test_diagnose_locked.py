"""A locked output whose play is known: not by the diagnosis' law, but by a gear of many flanks.

Each of them is held by its own friction and gives its own part of the play once the torque beats
it, so that the play is crossed over a range of torques, as in a gear of printed parts. What is
there to find is how far the twist stays apart where the torque is zero, from either side.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.diagnosis.concluding import conclude
from servo_bench.diagnosis.elsewhere.locked import dragged, judge_locked
from servo_bench.recording.plant import ForeignPlant
from servo_bench.recording.recording import Recording
from servo_bench.report.diagnosis_page import diagnosis_report

Array = NDArray[np.float64]
PEAK_NM, RAMP_ROWS = 4.0, 400


def ramps(runs: int) -> tuple[Array, Array]:
    """Torque to one side, the other and back, and the number of its run."""
    one = PEAK_NM * np.interp(
        np.arange(4 * RAMP_ROWS), RAMP_ROWS * np.array([0, 1, 3, 4]), [0.0, 1.0, -1.0, 0.0]
    )
    return np.tile(one, runs), np.repeat(np.arange(float(runs)), one.size)


def flanks(torque: Array, held_nm: Array, parts_rad: Array, compliance: float) -> Array:
    """Twist of a spring and of flanks that go over, each where the torque beats its friction."""
    side = -np.ones(held_nm.size)
    found = np.empty(torque.size)
    for k, value in enumerate(torque):
        side = np.where(value > held_nm, 1.0, np.where(value < -held_nm, -1.0, side))
        found[k] = compliance * value + 0.5 * parts_rad @ side
    return found


def locked(torque: Array, twist: Array, run: Array) -> Recording:
    channels = {
        "t_s": 1e-3 * np.arange(torque.size),
        "motor_torque_nm": torque,
        "motor_position_rad": twist,
        "run": run,
    }
    plant = ForeignPlant(name="gear", output_locked=True)
    return Recording(channels, 1e-3, None, None, {}, plant=plant)


@pytest.mark.parametrize("held", [(0.5, 1.0), (0.5, 2.5), (2.0, 3.4), (1.0, 3.4)])
@pytest.mark.parametrize("compliance", [0.0, 1e-3])
def test_play_is_how_far_a_gear_stays_apart_without_torque(
    held: tuple[float, float], compliance: float
) -> None:
    rng = np.random.default_rng(5)
    torque, run = ramps(5)
    parts = rng.dirichlet(np.full(60, 3.0)) * 0.03
    twist = flanks(torque, np.linspace(*held, 60), parts, compliance)
    verdict = conclude([locked(torque, twist + 1e-5 * rng.normal(size=run.size), run)]).verdict
    (cause,) = verdict.causes
    assert cause.effect == "backlash_width"
    assert cause.parameters["change_rad"].value == pytest.approx(0.03, rel=0.15)


def test_one_run_is_judged_by_its_end() -> None:
    """What its first part was fitted to is no evidence: there the gear was another."""
    torque, run = ramps(3)
    slack = np.where(np.arange(torque.size) < 0.7 * torque.size, 0.03, 0.0)
    twist = 2e-3 * torque + 0.5 * slack * np.sign(torque)
    noise = 1e-5 * np.random.default_rng(7).normal(size=run.size)
    found = judge_locked(locked(torque, twist + noise, np.zeros(run.size)))
    assert found.held["play"] > 10.0 * found.play.rms_rad


@pytest.mark.parametrize(("per_ampere", "unit"), [(0.05, "nm"), (None, "a")])
def test_a_current_is_a_torque_where_its_motor_is_described(
    per_ampere: float | None, unit: str
) -> None:
    rng = np.random.default_rng(5)
    torque, run = ramps(5)
    twist = flanks(torque, np.linspace(0.5, 1.0, 60), rng.dirichlet(np.full(60, 3.0)) * 0.03, 1e-3)
    told = locked(torque, twist + 1e-5 * rng.normal(size=run.size), run)
    current = {"current_a": torque / 0.05, **told.channels}
    del current["motor_torque_nm"]
    plant = ForeignPlant(name="gear", output_locked=True, torque_constant_nm_per_a=per_ampere)
    verdict = conclude([replace(told, channels=current, plant=plant)]).verdict
    (effect,) = (cause.effect for cause in verdict.causes)
    assert effect == "backlash_width"
    compliance = verdict.nuisances[f"compliance_rad_per_{unit}"]
    assert compliance == pytest.approx(1e-3 if per_ampere else 1e-3 * 0.05, rel=0.3)


def test_a_spring_has_no_play() -> None:
    torque, run = ramps(5)
    noise = np.random.default_rng(6).normal(size=run.size)
    verdict = conclude([locked(torque, 2e-3 * torque + 1e-4 * noise, run)]).verdict
    assert (verdict.verdict, verdict.causes) == ("none", ())


def test_a_verdict_on_few_seconds_says_so() -> None:
    for runs, told in ((5, 1), (8, 0)):
        torque, run = ramps(runs)
        noise = np.random.default_rng(6).normal(size=run.size)
        verdict = conclude([locked(torque, 2e-3 * torque + 1e-4 * noise, run)]).verdict
        assert verdict.verdict == "none"
        assert sum("8.0 s were recorded" in words for words in verdict.undecided) == told


@pytest.mark.long
@pytest.mark.parametrize(("true_rad", "declared_rad"), [(0.02, 0.02), (0.02, 0.03), (0.0, 0.02)])
def test_play_is_an_error_of_the_map_where_it_is_not_what_the_map_declares(
    true_rad: float, declared_rad: float
) -> None:
    torque, run = ramps(5)
    noise = 1e-5 * np.random.default_rng(9).normal(size=run.size)
    side = np.clip(dragged(torque, np.array([0.8]), np.zeros(1))[:, 0] / 0.6, -1.0, 1.0)
    told = locked(torque, 2e-3 * torque + 0.5 * true_rad * side + noise, run)
    plant = ForeignPlant(name="gear", output_locked=True, backlash_gap_rad=declared_rad)
    verdict = conclude([replace(told, plant=plant)]).verdict
    if true_rad == declared_rad:
        assert (verdict.verdict, verdict.causes) == ("none", ())
        assert "the map's 1.15 deg of play" in verdict.sentence
        return
    (cause,) = verdict.causes
    change_rad = cause.parameters["change_rad"].value
    assert change_rad == pytest.approx(true_rad - declared_rad, abs=1e-3)


@pytest.mark.long
def test_a_twist_that_the_torque_does_not_explain_is_no_spring_s() -> None:
    """It swings by itself, as another shaft's does; not so the noise of a gear that is rigid."""
    torque, run = ramps(5)
    rng = np.random.default_rng(10)
    swings = 0.02 * np.sin(0.0031 * np.arange(run.size)) + 1e-4 * rng.normal(size=run.size)
    verdict = conclude([locked(torque, swings, run)]).verdict
    assert (verdict.verdict, verdict.causes) == ("unknown", ())
    assert "Neither a linear spring nor play explains" in verdict.sentence
    assert "whether the twist follows" in verdict.next_run
    rigid = conclude([locked(torque, 1e-4 * rng.normal(size=run.size), run)]).verdict
    assert rigid.verdict == "none"


def test_runs_that_are_not_alike_are_not_called_a_spring() -> None:
    """A gear that goes over in some runs only: play explains those, and not the others."""
    torque, run = ramps(6)
    rng = np.random.default_rng(7)
    goes = flanks(torque, np.linspace(0.5, 1.5, 30), np.full(30, 1e-3), 1e-3)
    twist = np.where(run < 4, goes, 1e-3 * torque) + 1e-5 * rng.normal(size=run.size)
    verdict = conclude([locked(torque, twist, run)]).verdict
    assert (verdict.verdict, verdict.causes) == ("unknown", ())
    assert "not alike" in verdict.sentence
    assert verdict.next_run


@pytest.mark.long
def test_the_picture_shows_the_errors_of_which_the_verdict_tells() -> None:
    """The page has one, and what it draws has the figures that stand beside it."""
    torque, run = ramps(5)
    rng = np.random.default_rng(8)
    twist = flanks(torque, np.linspace(0.5, 2.5, 40), np.full(40, 5e-4), 1e-3)
    recording = locked(torque, twist + 1e-4 * rng.normal(size=run.size), run)
    concluded = conclude([recording])
    shown, error = concluded.shown, concluded.verdict.error
    assert shown is not None
    assert error is not None
    assert np.sqrt(np.mean((shown.measured - shown.plain) ** 2)) == pytest.approx(error.before)
    assert np.sqrt(np.mean((shown.measured - shown.extended) ** 2)) == pytest.approx(error.after)
    assert set(np.unique(np.round(shown.time_s / 1.6))) <= {3.0, 4.0, 5.0}  # the last runs
    page = diagnosis_report(*concluded, recording)
    assert all(words in page for words in ("<svg", "extended model", "twist (rad)"))
