"""What a load's encoder says wrong once or twice a revolution, read off its own angle."""

import math

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.comparison import Comparison, compare
from servo_bench.diagnosis.comparing.evidence import SCALES
from servo_bench.diagnosis.reading.revolution import not_at_rest, turn_waves
from servo_bench.diagnosis.searching.coasting import coasting
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, STANDSTILL, recorded, with_channels

MODEL = Model(NOMINAL)
BOUNCING = coasting(MODEL, 700.0)
SLOTS = 2500
COUNT_RAD = math.tau / 65536.0


def turning(seed: int) -> np.ndarray:
    """After a standstill, commands at random about 1 rad/s, so that the shaft makes three turns."""
    moving = 1.0 + np.random.default_rng(seed).uniform(-4.0, 4.0, SLOTS)
    return np.concatenate((np.zeros(STANDSTILL), moving))


def run(seed: int, model: Model) -> Recording:
    return recorded(model, seed, played=turning(seed))


def against(recording: Recording, model: Model = MODEL) -> Comparison:
    return compare(recording, model, scales=SCALES)


@pytest.mark.parametrize("seed", [51, 52])
@pytest.mark.parametrize("rig", [MODEL, BOUNCING], ids=["rigid", "bouncing"])
def test_an_eccentric_track_of_a_count_has_its_size_and_phase(seed: int, rig: Model) -> None:
    wave = {"amplitude_rad": COUNT_RAD, "phase_rad": 0.9}
    found = turn_waves(against(run(seed, rig.with_effect("encoder_eccentricity", **wave))), MODEL)
    (one,) = (wave.reading() for wave in found)
    assert one.effect == "encoder_eccentricity"
    for name, error in one.errors.items():
        assert one.settings[name] == pytest.approx(wave[name], abs=4.0 * error)


@pytest.mark.parametrize("seed", [53, 54])
def test_shafts_that_meet_at_a_degree_are_told_by_that_angle(seed: int) -> None:
    joint = {"angle_rad": math.radians(1.0), "phase_rad": -0.5}
    recording = run(seed, BOUNCING.with_effect("misalignment", **joint))
    (one,) = (wave.reading() for wave in turn_waves(against(recording), MODEL))
    assert one.effect == "misalignment"
    for name, error in one.errors.items():
        assert one.settings[name] == pytest.approx(joint[name], abs=4.0 * error)
    extended = MODEL.with_effect(one.effect, **one.settings)
    assert turn_waves(against(recording, extended), extended) == ()


@pytest.mark.parametrize("seed", [55, 56, 57, 58])
def test_a_load_that_bounces_in_a_gap_that_is_wrong_makes_no_wave(seed: int) -> None:
    wider = BOUNCING.with_effect("backlash_width", change_rad=2e-3)
    assert turn_waves(against(run(seed, wider)), MODEL) == ()


def test_what_is_in_one_half_of_the_recording_is_not_the_encoders() -> None:
    recording = run(59, MODEL)
    angle = np.array(recording["load_angle_rad"])
    half = angle.size // 2
    angle[half:] += 2.0 * COUNT_RAD * np.sin(angle[half:])
    assert turn_waves(against(with_channels(recording, load_angle_rad=angle)), MODEL) == ()


def test_half_a_turn_tells_nothing() -> None:
    still = np.random.default_rng(60).uniform(-1.0, 1.0, SLOTS)
    eccentric = MODEL.with_effect("encoder_eccentricity", amplitude_rad=1e-3)
    played = np.concatenate((np.zeros(STANDSTILL), still - still.mean()))
    recording = recorded(eccentric, 60, played=played)
    assert np.ptp(np.asarray(recording["load_angle_rad"])) < math.pi
    assert turn_waves(against(recording), MODEL) == ()


@pytest.mark.parametrize(
    ("there", "fitted", "false"),
    [
        (0.0, 2e-4, True),  # a fit bent it to what bounces
        (2e-4, 2e-4, False),
        (1.4e-4, 2e-4, False),  # wrong by its size only
        (2e-4, 6e-4, True),
    ],
)
def test_a_wave_that_the_load_has_not_where_it_rests_is_none(
    there: float, fitted: float, false: bool
) -> None:
    wave = {"phase_rad": 0.7}
    rig = BOUNCING.with_effect("encoder_eccentricity", amplitude_rad=there, **wave)
    model = BOUNCING.with_effect("encoder_eccentricity", amplitude_rad=fitted, **wave)
    found = not_at_rest(against(run(61, rig), model), model)
    assert found == (frozenset({"encoder_eccentricity"}) if false else frozenset())


def test_a_joint_that_the_load_has_not_where_it_rests_is_none() -> None:
    model = BOUNCING.with_effect("misalignment", angle_rad=math.radians(2.0), phase_rad=0.4)
    assert not_at_rest(against(run(62, BOUNCING), model), model) == {"misalignment"}
    assert not_at_rest(against(run(62, model), model), model) == frozenset()
