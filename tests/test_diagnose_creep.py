"""A load's angle that gives way to the torque slowly: what no effect of the catalogue does."""

import math
from typing import Any

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.comparison import Comparison, compare
from servo_bench.diagnosis.comparing.evidence import SCALES
from servo_bench.diagnosis.judging.judgement import verdict_of
from servo_bench.diagnosis.reading.creep import creep
from servo_bench.diagnosis.searching.coasting import coasting
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, STANDSTILL, recorded, with_channels

MODEL = Model(NOMINAL)
BOUNCING = coasting(MODEL, 700.0)
RUBBING = MODEL.with_effect("coulomb", torque_nm=0.01)
SLOTS = 3000
COUNT_RAD = math.tau / 65536.0


def run(seed: int, model: Model) -> Recording:
    """Commands at random about 1 rad/s, some of which stay for a quarter of a second."""
    draw = np.random.default_rng(seed)
    held = np.repeat(draw.uniform(-4.0, 4.0, SLOTS), draw.integers(1, 32, SLOTS))[:SLOTS]
    return recorded(model, seed, played=np.concatenate((np.zeros(STANDSTILL), 1.0 + held)))


def against(recording: Recording, model: Model = MODEL) -> Comparison:
    return compare(recording, model, scales=SCALES)


def gives_way(recording: Recording, gives_rad_per_nm: float, time_s: float) -> Recording:
    """The recording, its load encoder on a bracket that creeps: tau dx/dt = k T - x, step by step.

    T is the motor's torque as the drive tells it.
    """
    torque, angle = np.asarray(recording["motor_torque_nm"]), np.array(recording["load_angle_rad"])
    share, crept = 1.0 - math.exp(-recording.period_s / time_s), 0.0
    for row, torque_nm in enumerate(np.nan_to_num(torque)):
        crept += share * (gives_rad_per_nm * float(torque_nm) - crept)
        angle[row] -= crept
    counts = np.rint(angle / COUNT_RAD) * COUNT_RAD
    return with_channels(recording, load_angle_rad=counts)


@pytest.mark.parametrize("seed", [71, 72])
@pytest.mark.parametrize("rig", [RUBBING, BOUNCING], ids=["rubbing", "bouncing"])
@pytest.mark.parametrize("time_s", [0.2, 0.8])
def test_a_bracket_that_creeps_is_told_with_what_it_gives(
    seed: int, rig: Model, time_s: float
) -> None:
    given = 0.15
    found: Any = creep(against(gives_way(run(seed, rig), given, time_s)), rig)
    assert found.compliance_rad_per_nm < 0.0  # the encoder reads less
    assert found.rate_rad_s_per_nm == pytest.approx(given / time_s, rel=0.3)
    assert found.time_s == pytest.approx(time_s, rel=0.6)


@pytest.mark.parametrize(("given", "told"), [(0.07, True), (-0.07, False)])
def test_a_little_that_comes_back_is_a_faces_own_law(given: float, told: bool) -> None:
    """Some 15 standard errors and 0.55 of the noise, either way."""
    small = gives_way(run(71, BOUNCING), given, 0.5)
    assert (creep(against(small), BOUNCING) is not None) is told


@pytest.mark.parametrize("seed", [73, 74])
@pytest.mark.parametrize(
    "rig",
    [
        RUBBING,
        BOUNCING,
        BOUNCING.with_effect("backlash_width", change_rad=2e-3),
        MODEL.with_effect("encoder_eccentricity", amplitude_rad=1e-3),
        MODEL.with_effect("clock_skew", skew_fraction=3e-5),
    ],
    ids=["rubbing", "bouncing", "wider", "eccentric", "late"],
)
def test_what_acts_at_once_does_not_creep(seed: int, rig: Model) -> None:
    assert creep(against(run(seed, rig)), MODEL) is None


def test_creep_of_half_a_recording_is_none() -> None:
    recording = run(75, RUBBING)
    crept = np.asarray(gives_way(recording, 0.15, 0.4)["load_angle_rad"])
    angle = np.array(recording["load_angle_rad"])
    half = angle.size // 2
    angle[half:] = crept[half:]
    assert creep(against(with_channels(recording, load_angle_rad=angle)), RUBBING) is None


@pytest.mark.nightly
def test_its_verdict_is_unknown_and_says_what_it_is() -> None:
    recording = gives_way(run(77, MODEL), 0.15, 0.4)
    verdict = verdict_of(find_causes([recording], MODEL, only=("misalignment",)))
    assert verdict.verdict == "unknown"
    assert "gives way to the motor's torque slowly" in verdict.sentence
    right = verdict_of(find_causes([run(77, MODEL)], MODEL, only=("misalignment",)))
    assert right.verdict == "none"


def test_of_a_load_encoder_alone_it_is_not_asked() -> None:
    recording = gives_way(run(76, RUBBING), 0.15, 0.4)
    channels = {n: v for n, v in recording.channels.items() if not n.startswith("motor")}
    alone = Recording(
        channels=channels,
        period_s=recording.period_s,
        experiment=recording.experiment,
        rig=recording.rig,
        provenance=recording.provenance,
    )
    assert creep(against(alone), RUBBING) is None
