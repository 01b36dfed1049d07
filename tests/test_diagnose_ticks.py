"""A drive that takes commands at its own ticks, under a clock that walks past them."""

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import Evidence, evidence_of
from servo_bench.diagnosis.comparing.ticks import COARSE_S, ticks
from servo_bench.diagnosis.judging.judgement import verdict_of
from servo_bench.diagnosis.searching.finding import find_causes
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, STANDSTILL, commands, recorded
from tests.trials.drawing import Question
from tests.trials.handing import nominal_rig, straight
from tests.truth import hidden

MODEL = Model(NOMINAL)
WALKING_FAR = MODEL.with_effect("clock_skew", skew_fraction=5e-5)
SEED, SLOTS, MEAN = 6, 900, 6


@pytest.fixture(scope="module")
def seen() -> Evidence:
    return evidence_of([recorded(MODEL, SEED, slots=SLOTS)], MODEL, block="loop")


def test_an_unknown_delay_moves_an_angle_by_velocity_times_delay(seen: Evidence) -> None:
    """x(t - d) = x(t) - d v(t): a mean velocity over slots of T changes by d/T of what the velocity
    does between its ends, in the windows that there are."""
    velocity = MODEL.simulate(commands(SEED, SLOTS), PERIOD_S).motor_velocity_rad_s
    between = np.abs(velocity[MEAN:] - velocity[:-MEAN])
    late_s = COARSE_S / np.sqrt(12.0)
    wanted = 1.4826 * float(np.median(between)) * late_s / (MEAN * PERIOD_S)
    found = dict(zip(seen.names, ticks(seen, WALKING_FAR), strict=True))
    assert found["motor velocity over 48 ms"] == pytest.approx(wanted, rel=0.3)


@pytest.mark.parametrize("skew_fraction", [0.0, 1e-12])
def test_where_no_clock_walks_the_delay_is_known(seen: Evidence, skew_fraction: float) -> None:
    late = MODEL.with_effect("transport_delay", delay_s=1e-4)
    found = ticks(seen, late.with_effect("clock_skew", skew_fraction=skew_fraction))
    assert float((found / seen.allowed).max()) < 1e-3
    np.testing.assert_array_equal(ticks(seen, late), 0.0)


def test_less_than_a_tick_is_walked_past_less_of_it(seen: Evidence) -> None:
    seconds = (SLOTS + STANDSTILL) * PERIOD_S
    little = MODEL.with_effect("clock_skew", skew_fraction=0.1 * COARSE_S / seconds)
    of_it = ticks(seen, little) / np.maximum(ticks(seen, WALKING_FAR), 1e-12)
    quick = list(seen.names).index("motor velocity over 48 ms")
    assert of_it[quick] == pytest.approx(0.1, rel=0.3)


def test_a_delay_is_never_less_than_none_and_the_other_way_still_counts(seen: Evidence) -> None:
    late = WALKING_FAR.with_effect("transport_delay", delay_s=5e-4)
    quick = list(seen.names).index("motor velocity over 48 ms")
    assert ticks(seen, late)[quick] == pytest.approx(ticks(seen, WALKING_FAR)[quick], rel=0.3)


def test_between_two_ticks_a_current_shows_a_part_of_every_jump() -> None:
    """So that where samples come to see the next command, the current may miss any part of one; a
    clock that walks the other way shows none of it."""
    jumps = np.random.default_rng(SEED).choice([-4.0, -2.0, 2.0, 4.0], SLOTS)
    played = np.concatenate((np.zeros(STANDSTILL), jumps))
    seen = evidence_of([recorded(MODEL, SEED, played=played)], MODEL, block="loop")
    slow = MODEL.with_effect("current_loop_lag", lag_s=1e-4)
    late = slow.with_effect("transport_delay", delay_s=1e-5)
    current = list(seen.names).index("torque")
    crosses, other = (
        ticks(seen, late.with_effect("clock_skew", skew_fraction=s))[current] for s in (-2e-5, 2e-5)
    )
    assert crosses > 5.0 * seen.allowed[current] > 20.0 * other


def test_every_step_of_the_staircase_stays_in_the_slow_velocities() -> None:
    """Seconds apart, and each with the speed of the command that it comes in: drawn at random."""
    draw = np.random.default_rng(SEED)
    played = np.concatenate((np.zeros(STANDSTILL), draw.choice([-6.0, 6.0], 5000)))
    seen = evidence_of([recorded(MODEL, SEED, played=played)], MODEL, block="loop")
    late = WALKING_FAR.with_effect("transport_delay", delay_s=5e-4)
    found = dict(zip(seen.names, ticks(seen, late), strict=True))
    rows = 216
    times = draw.uniform(0.0, 4000.0, round(4000.0 * 5e-5 / COARSE_S))
    ahead = draw.choice([-6.0, 6.0], times.size) * COARSE_S
    angle = np.bincount((times / PERIOD_S).astype(int), ahead, round(4000.0 / PERIOD_S)).cumsum()
    means = angle[: angle.size // rows * rows].reshape(-1, rows).mean(axis=1)
    wanted = float(np.sqrt(np.mean((np.diff(means) / (rows * PERIOD_S)) ** 2)))
    assert wanted > 0.5 * seen.allowed[list(seen.names).index("motor velocity over 1728 ms")]
    assert found["motor velocity over 1728 ms"] == pytest.approx(wanted, rel=0.15)


@pytest.mark.parametrize(("seed", "seconds"), [(871005, 44.0), (871011, 16.0)])
@pytest.mark.nightly
def test_a_clock_that_walks_past_a_few_ticks_is_named(seed: int, seconds: float) -> None:
    """Its delay goes in steps, which a slope would take for a change, and its number is not sure
    after 16 s: still it takes most of what is wrong."""
    question, skew = Question(seed=seed, seconds=seconds), hidden.hide(seed, {"clock_skew": -1e-5})
    seen, held_out = (straight(question, skew, take) for take in (0, 1))
    model = nominal_rig(question.nominal).model()
    verdict = verdict_of(find_causes([seen], model, held_out=held_out, only=("clock_skew",)))
    assert verdict.names == ("clock_skew",)
    skew_fraction = verdict.causes[0].parameters["skew_fraction"]
    assert -2e-5 < skew_fraction.value < -5e-6
    low, high = skew_fraction.ci95
    assert seconds < 40.0 or low < -1e-5 < high
