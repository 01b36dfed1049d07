"""Designing a run: within the rig's limits, playable, and better where the physics says so."""

import math
from functools import cache
from pathlib import Path

import pytest
from typer.testing import CliRunner

from servo_bench.cli import app as cli
from servo_bench.cli.design import ambiguous_pairs, experiment_text
from servo_bench.diagnosis.candidates import MARGIN, ROOM, Plan, candidates
from servo_bench.diagnosis.design import Pair, Separation, ranked, separation
from servo_bench.diagnosis.judging.verdict import Cause, Verdict
from servo_bench.errors import ConfigError
from servo_bench.excitation.experiment import load_experiment
from servo_bench.excitation.prediction import predict
from servo_bench.rig import load_rig
from servo_bench.run.virtual import play_virtually

RIG, PERIOD_S, MINUTES = "rigs/paper.toml", 0.008, 0.5


@cache
def grid() -> tuple[Plan, ...]:
    """What could be played on the rig of the paper: simulated once, and only where it is asked."""
    return candidates(load_rig(RIG), RIG, MINUTES, PERIOD_S)


@pytest.mark.long
def test_every_candidate_stays_within_the_rigs_limits_and_reads_back(tmp_path: Path) -> None:
    limits, path = load_rig(RIG).limits, tmp_path / "experiment.toml"
    for plan in grid():
        schedule = plan.experiment.schedule()
        assert schedule.peak_travel_rad <= MARGIN * limits.travel_rad, plan.words
        assert schedule.peak_velocity_rad_s <= MARGIN * limits.velocity_rad_s, plan.words
        seen = predict(schedule, load_rig(RIG))  # the motor overshoots what it is told
        assert seen.peak_velocity_rad_s <= ROOM * limits.velocity_rad_s, plan.words
        assert seen.motor_travel_rad <= ROOM * limits.travel_rad, plan.words
        assert schedule.duration_s == pytest.approx(60.0 * MINUTES, rel=0.2), plan.words
        path.write_text(experiment_text(plan.experiment))
        assert load_experiment(path) == plan.experiment


def test_full_turns_tell_an_encoder_off_centre_from_a_weight_off_centre() -> None:
    model, pair = load_rig(RIG).model(), frozenset({"encoder_eccentricity", "gravity_imbalance"})
    same = [p for p in grid() if p.levels == "five levels" and p.dwell == 1]
    still = next(p for p in same if p.bias_rad_s == 0.0)
    turning = min(
        (p for p in same if p.bias_rad_s > 0.0),
        key=lambda p: abs(p.amplitude_rad_s - still.amplitude_rad_s),
    )
    told = [
        separation(plan, model, only=tuple(pair), pairs=[pair], sizes={}).worst
        for plan in (still, turning)
    ]
    assert told[1] > 1.5 * told[0] > 0.0


def test_the_best_has_the_best_worst_pair_and_hopeless_pairs_do_not_count() -> None:
    one, other = grid()[:2]
    hopeless = Pair("a", "z", 0.1)
    low = Separation(one, {}, (hopeless, Pair("a", "b", 2.0)))
    high = Separation(other, {}, (hopeless, Pair("a", "b", 4.0)))
    best, second = ranked([low, high])
    assert (best.plan, best.worst, second.worst) == (other, 4.0, 2.0)
    assert best.minutes_to_split == pytest.approx(25.0 / 16.0)
    assert math.isinf(Separation(one, {}, ()).minutes_to_split)
    assert best.split_in_a_minute == 0
    assert Separation(one, {}, (hopeless, Pair("a", "b", 5.0))).split_in_a_minute == 1


def test_a_pair_that_one_candidate_shows_by_accident_does_not_decide() -> None:
    """A deadband is seen where a bias is as small; the others tell all the rest."""
    one, other = grid()[:2]
    names = ("b", "c", "d", "e")
    lucky = Separation(one, {}, (Pair("a", "z", 1.5), *(Pair("a", n, 1.6) for n in names)))
    useful = Separation(other, {}, (Pair("a", "z", 0.0), *(Pair("a", n, 6.0) for n in names)))
    best, second = ranked([lucky, useful])
    assert best.plan == other
    assert (best.told, second.told) == pytest.approx((0.8, (1.5 + 4 * 1.6) / 25.0))


def test_a_rig_without_a_gap_is_not_limited_to_what_a_gap_asks_for() -> None:
    rig = load_rig(RIG)
    solid = {"nominal": rig.nominal.model_copy(update={"backlash_gap_rad": 0.0})}
    wide = {"limits": rig.limits.model_copy(update={"velocity_rad_s": 12.0, "travel_rad": 80.0})}
    grid = candidates(rig.model_copy(update=solid | wide), RIG, MINUTES, PERIOD_S)
    largest = max(plan.amplitude_rad_s for plan in grid)
    assert largest > 0.4 * 12.0
    assert min(plan.amplitude_rad_s for plan in grid) < 0.3 * largest


@pytest.mark.long
def test_limits_that_leave_no_room_are_told() -> None:
    rig = load_rig(RIG)
    tight = rig.model_copy(update={"limits": rig.limits.model_copy(update={"travel_rad": 0.01})})
    with pytest.raises(ConfigError, match="travel_rad"):
        candidates(tight, RIG, MINUTES, PERIOD_S)
    weak = rig.model_copy(update={"limits": rig.limits.model_copy(update={"torque_nm": 1e-7})})
    with pytest.raises(ConfigError, match="torque_nm = 1e-07"):
        candidates(weak, RIG, MINUTES, PERIOD_S)
    with pytest.raises(ConfigError, match="--minutes"):
        candidates(rig, RIG, 0.1, PERIOD_S)


@pytest.mark.long
def test_a_torque_limit_makes_the_excitation_smaller() -> None:
    rig = load_rig(RIG)
    weak = rig.model_copy(update={"limits": rig.limits.model_copy(update={"torque_nm": 0.05})})
    for plan in candidates(weak, RIG, MINUTES, PERIOD_S):
        peak_a = predict(plan.experiment.schedule(), weak).peak_current_a
        assert peak_a * rig.nominal.torque_constant_nm_per_a <= ROOM * 0.05


def test_what_is_designed_can_be_played() -> None:
    config = load_rig(RIG)
    hardest = max(
        grid(), key=lambda p: predict(p.experiment.schedule(), config).peak_velocity_rad_s
    )
    assert play_virtually(hardest.experiment, config).error is None


def test_a_verdicts_pairs() -> None:
    cause = Cause(
        effect="coulomb", parameters={}, confidence=0.5, ambiguous_with=("viscous", "stribeck")
    )
    verdict = Verdict(verdict="named", sentence="", causes=(cause,))
    wanted = {frozenset({"coulomb", "viscous"}), frozenset({"coulomb", "stribeck"})}
    assert ambiguous_pairs(verdict) == wanted
    with pytest.raises(ConfigError, match="no two causes"):
        ambiguous_pairs(Verdict(verdict="none", sentence=""))


def test_a_verdict_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "verdict.json"
    path.write_text('{"verdict": "perhaps"}')
    words = ["design", "diagnosis", "--rig", RIG, "-o", tmp_path / "e.toml", "--verdict", path]
    found = CliRunner().invoke(cli.app, [str(w) for w in words])
    assert isinstance(found.exception, ConfigError)
    assert "is no verdict" in str(found.exception)
