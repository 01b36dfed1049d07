"""Torque that is noise in motion, and none at rest: so much more may a simulation miss of it."""

import math

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.allowance import FLOORS
from servo_bench.diagnosis.comparing.evidence import evidence_of
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.comparing.scatter import QUICKEST_LOOP_S, most_of_counts, scatter
from servo_bench.excitation.experiment import Phase
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, recorded, with_channels

MODEL = Model(NOMINAL)
NOISE_NM = 2e-3


@pytest.fixture(scope="module")
def run() -> Recording:
    return recorded(MODEL, 81, slots=2000)


def told(run: Recording, model: Model = MODEL) -> float:
    """Of the torque."""
    whole = evidence_of([run], model)
    found = scatter(whole, model)
    k = whole.names.index("torque")
    assert not np.delete(found, k).any()
    return float(found[k])


def noisy(run: Recording, more_nm: Array | float = 0.0) -> Recording:
    """With noise on the torque wherever the motor was commanded to turn."""
    noise_nm = np.random.default_rng(82).normal(0.0, NOISE_NM, len(run))
    moving = run["phase"] != Phase.STANDSTILL
    added_nm = np.where(moving, noise_nm + more_nm, 0.0)
    return with_channels(run, motor_torque_nm=run["motor_torque_nm"] + added_nm)


def test_noise_of_nothing_but_motion_is_what_may_be_missed(run: Recording) -> None:
    assert told(noisy(run)) == pytest.approx(FLOORS * NOISE_NM, rel=0.1)


def test_what_follows_the_motion_is_no_noise(run: Recording) -> None:
    """Friction shows in the velocity's bins; what a command brings at once, or a row later, after
    its jumps; a torque that repeats slowly remembers itself."""
    velocity = np.gradient(np.array(run["motor_position_rad"]), run.period_s)
    jumps = np.diff(np.array(run["velocity_command_rad_s"]), prepend=0.0)
    assert told(noisy(run, 0.3 * NOISE_NM * np.sign(velocity))) == 0.0
    for late in (0, 1):
        kicks = np.roll(jumps, late) / jumps.std()
        assert told(noisy(run, 0.3 * NOISE_NM * kicks)) == 0.0
    slow = np.sin(2.0 * np.pi * 0.7 * run.period_s * np.arange(len(run)))
    assert told(noisy(run, 0.6 * NOISE_NM * slow)) == 0.0


def test_it_is_no_more_than_the_counts_that_are_told_could_make(run: Recording) -> None:
    fine_rad = 1e-6
    within = np.random.default_rng(83).uniform(-5e-5, 5e-5, len(run))
    position = np.round((run["motor_position_rad"] + within) / fine_rad) * fine_rad
    fine = with_channels(noisy(run), motor_position_rad=position)
    most_a = most_of_counts(evidence_of([fine], MODEL).fitted[0], MODEL)
    most_nm = NOMINAL.torque_constant_nm_per_a * most_a
    assert most_nm < NOISE_NM
    assert told(fine) == pytest.approx(FLOORS * most_nm)


def test_a_counted_velocity_is_off_by_a_count_over_the_square_root_of_six_periods() -> None:
    """The noise of a drive that counts, by a shaft at uneven speed, against `most_of_counts`."""
    step_rad, period_s = 1e-4, QUICKEST_LOOP_S
    speed = 30.0 + 5.0 * np.sin(2.0 * np.pi * 3.0 * period_s * np.arange(200_000))
    angle = np.cumsum(speed) * period_s
    counted = np.diff(np.floor(angle / step_rad)) * step_rad / period_s
    rms = float(np.std(counted - speed[1:]))
    assert rms == pytest.approx(step_rad / (math.sqrt(6.0) * period_s), rel=0.05)
