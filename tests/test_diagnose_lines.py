"""Lines in a load's error: of its own scale by the angle, and of something outside by the time."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from servo_bench.diagnosis.comparing.comparison import Comparison, compare
from servo_bench.diagnosis.comparing.evidence import SCALES
from servo_bench.diagnosis.judging.judgement import verdict_of
from servo_bench.diagnosis.reading.subdivision import EFFECT as SCALE
from servo_bench.diagnosis.reading.subdivision import load_lines, subdivision
from servo_bench.diagnosis.reading.tone import period_of, tone
from servo_bench.diagnosis.searching.coasting import coasting
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.excitation.experiment import Phase
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, STANDSTILL, commands, recorded, rows, with_channels

MODEL = Model(NOMINAL)
SLOTS, SHORT, PERIOD_S = 2500, 1300, 0.008
LINES, PERIOD = 256, 300
BOUNCING = coasting(MODEL, 700.0)


def in_periods(seed: int, times: int) -> np.ndarray:
    """Five levels, PERIOD rows of them over and over."""
    one = np.random.default_rng(seed).choice([-6.0, -2.0, 0.0, 2.0, 6.0], PERIOD)
    return np.concatenate((np.zeros(STANDSTILL), np.tile(one, times)))


def compared(
    seed: int, model: Model, error_rad: np.ndarray | None = None, slots: int = SLOTS
) -> Comparison:
    recording = recorded(model, seed, slots=slots)
    if error_rad is not None:
        angle = np.array(recording["load_angle_rad"])
        recording = with_channels(recording, load_angle_rad=angle + error_rad[: angle.size])
    return compare(recording, MODEL, scales=SCALES)


def shaken(seed: int, played: np.ndarray, error_rad: np.ndarray) -> Recording:
    recording = recorded(MODEL, seed, played=played)
    angle = np.asarray(recording["load_angle_rad"]) + error_rad
    return with_channels(recording, load_angle_rad=angle)


def _with_a_slot_skipped(recording: Recording) -> Recording:
    return rows(recording, np.delete(np.arange(len(recording)), len(recording) // 3))


def _with_samples_that_did_not_come(recording: Recording) -> Recording:
    angle = np.array(recording["load_angle_rad"])
    angle[np.random.default_rng(1).random(angle.size) < 0.05] = np.nan
    return with_channels(recording, load_angle_rad=angle)


HARMED = {
    "skipped": _with_a_slot_skipped,
    "samples": _with_samples_that_did_not_come,
}


@pytest.mark.parametrize("seed", [31, 32])
def test_a_faint_scale_is_found_beside_a_load_that_bounces(seed: int) -> None:
    scale = {"amplitude_rad": 4.5e-5, "line_order": float(LINES)}
    lines = load_lines(compared(seed, BOUNCING.with_effect("encoder_subdivision", **scale)), MODEL)
    assert [line.order for line in lines] == [LINES]


@pytest.mark.parametrize("seed", [33, 34, 35])
def test_a_load_that_bounces_makes_no_line(seed: int) -> None:
    assert load_lines(compared(seed, BOUNCING), MODEL) == ()


@pytest.mark.parametrize(("seed", "amplitude_rad"), [(41, 3e-5), (42, 5e-5), (43, 2e-4)])
def test_a_wave_of_a_third_of_a_count_has_its_size_and_phase(
    seed: int, amplitude_rad: float
) -> None:
    """The encoder counts 9.6e-5 rad, and its noise is one of them."""
    wave = {"amplitude_rad": amplitude_rad, "line_order": float(LINES), "phase_rad": 0.7}
    found = subdivision(compared(seed, MODEL.with_effect("encoder_subdivision", **wave)), MODEL)
    assert found is not None
    assert found.line_order == LINES
    error = found.standard_error_rad
    assert 1e-6 < error < 7e-6
    assert found.amplitude_rad == pytest.approx(amplitude_rad, abs=3.0 * error)
    assert found.phase_rad == pytest.approx(0.7, abs=3.0 * error / amplitude_rad)


def test_a_load_that_bounces_has_its_scales_wave_where_it_rests() -> None:
    """Slowed by less, it is thrown about for most of the rows, and they say another wave."""
    wave = {"amplitude_rad": 9e-5, "line_order": float(LINES), "phase_rad": 0.7}
    thrown = coasting(MODEL, 300.0).with_effect("encoder_subdivision", **wave)
    found = subdivision(compared(48, thrown), MODEL)
    assert found is not None
    assert found.line_order == LINES
    error = found.standard_error_rad
    assert found.amplitude_rad == pytest.approx(9e-5, abs=3.0 * error)
    assert found.phase_rad == pytest.approx(0.7, abs=3.0 * error / 9e-5)


@pytest.mark.parametrize("seed", [38, 39, 40])
def test_errors_that_hang_together_make_no_line(seed: int) -> None:
    """A shaft that rests between moves says one wrong thing ten times at one place."""
    draw, rests = np.random.default_rng(seed), SLOTS // 11 + 1
    moves = np.repeat(draw.uniform(0.0, 12.0, rests), 11)[:SLOTS]
    played = np.where(np.arange(SLOTS) % 11 < 1, moves, 0.0)
    played = np.concatenate((np.zeros(STANDSTILL), played))
    recording = recorded(MODEL, seed, played=played, noise_counts=0.1)
    wrong = np.repeat(3e-4 * draw.standard_normal(rests + 6), 11)[: len(recording)]
    angle = np.asarray(recording["load_angle_rad"]) + wrong
    stuck = compare(with_channels(recording, load_angle_rad=angle), MODEL, scales=SCALES)
    assert load_lines(stuck, MODEL) == ()


def test_what_is_in_one_half_of_the_recording_is_not_the_discs() -> None:
    wave = {"amplitude_rad": 1e-4, "line_order": float(LINES)}
    recording = recorded(MODEL, 44, slots=SLOTS)
    with_wave = recorded(MODEL.with_effect("encoder_subdivision", **wave), 44, slots=SLOTS)
    half = len(recording) // 2
    angle = np.array(recording["load_angle_rad"])
    angle[half:] = np.array(with_wave["load_angle_rad"])[half:]
    late = compare(with_channels(recording, load_angle_rad=angle), MODEL, scales=SCALES)
    assert load_lines(late, MODEL)
    assert subdivision(late, MODEL) is None


def test_what_is_not_in_the_rows_that_were_held_out_is_not_the_discs() -> None:
    """Where commands come again the same places have the same errors, and halves agree."""
    wave = {"amplitude_rad": 1e-4, "line_order": float(LINES)}
    played = np.concatenate((commands(55, SLOTS), commands(56, 900)[STANDSTILL:]))
    without = recorded(MODEL, 55, played=played)
    with_wave = recorded(MODEL.with_effect("encoder_subdivision", **wave), 55, played=played)
    phase = np.full(len(without), Phase.IDENTIFICATION, np.uint32)
    phase[:STANDSTILL], phase[SLOTS:] = Phase.STANDSTILL, Phase.VALIDATION
    angle = np.array(with_wave["load_angle_rad"])
    everywhere = with_channels(with_wave, phase=phase)
    assert subdivision(compare(everywhere, MODEL, scales=SCALES), MODEL) is not None
    angle[SLOTS:] = np.array(without["load_angle_rad"])[SLOTS:]
    seen = with_channels(without, phase=phase, load_angle_rad=angle)
    assert subdivision(compare(seen, MODEL, scales=SCALES), MODEL) is None


@pytest.mark.parametrize("validation", [40, 90])
def test_what_was_held_out_denies_nothing_where_it_is_short(validation: int) -> None:
    wave = {"amplitude_rad": 2e-4, "line_order": float(LINES)}
    recording = recorded(MODEL.with_effect("encoder_subdivision", **wave), 57, slots=SLOTS)
    phase = np.array(recording["phase"])
    phase[STANDSTILL:-validation] = Phase.IDENTIFICATION
    short = compare(with_channels(recording, phase=phase), MODEL, scales=SCALES)
    assert subdivision(short, MODEL) is not None


def test_a_floor_that_shakes_is_heard() -> None:
    shaking = 4e-4 * np.sin(math.tau * 23.0 * PERIOD_S * np.arange(SLOTS + 200))
    heard = tone(compared(36, BOUNCING, shaking), MODEL)
    assert heard is not None
    assert heard.frequency_hz == pytest.approx(23.0, abs=0.1)


def test_a_faint_line_in_a_hole_of_the_spectrum_is_none() -> None:
    slots = np.arange(SHORT + 200)
    white = np.random.default_rng(37).standard_normal(slots.size)
    smooth = lfilter(np.poly(-np.ones(8)), 1.0, white)  # eight means of neighbours: 0 at 62.5 Hz
    faint = 5e-5 * np.sin(math.tau * 62.19 * PERIOD_S * slots)
    error_rad = 3e-4 * smooth / float(np.std(smooth)) + faint
    assert tone(compared(37, MODEL, error_rad, SHORT), MODEL) is None


@pytest.mark.parametrize("seed", [49, 50, 51])
@pytest.mark.parametrize("harm", [lambda r: r, *HARMED.values()], ids=["whole", *HARMED])
def test_what_comes_with_every_period_of_the_commands_is_no_tone(
    harm: Callable[[Recording], Recording], seed: int
) -> None:
    """An error that is the same in each has lines at multiples of its rate, and nothing between."""
    wrong = 5e-4 * np.random.default_rng(seed).standard_normal(PERIOD)
    again = np.concatenate((np.zeros(STANDSTILL), np.tile(wrong, 8)))
    recording = harm(shaken(seed, in_periods(seed, 8), again))
    assert tone(compare(recording, MODEL, scales=SCALES), MODEL) is None


def test_a_floor_that_shakes_is_heard_beside_commands_that_come_again() -> None:
    played = in_periods(52, 8)
    shaking = 4e-4 * np.sin(math.tau * 23.04 * PERIOD_S * np.arange(played.size))
    heard = tone(compare(shaken(52, played, shaking), MODEL, scales=SCALES), MODEL)
    assert heard is not None
    assert heard.frequency_hz == pytest.approx(23.04, abs=0.05)


@pytest.mark.parametrize("bias", [0.0, 3.0, 9.0])
@pytest.mark.parametrize("times", [2, 3, 8])
def test_the_period_of_commands(times: int, bias: float) -> None:
    """Where some are lost too, and the one before is heard once more."""
    for seed in range(40):
        played = in_periods(seed, times)
        played[STANDSTILL:] += bias
        assert period_of(played) == PERIOD
        lost = 1 + np.flatnonzero(np.random.default_rng(seed).random(played.size - 1) < 0.05)
        heard = played.copy()
        heard[lost] = played[lost - 1]
        assert period_of(heard) == PERIOD


def test_commands_that_do_not_come_again_have_no_period() -> None:
    draw = np.random.default_rng(54)
    assert period_of(draw.choice([-4.0, 4.0], 2000)) == 0
    assert period_of(np.repeat(draw.uniform(-4.0, 4.0, 4), 500)) == 0
    assert period_of(np.full(900, 3.0)) == 0
    assert period_of(np.zeros(900)) == 0
    assert period_of(np.full(900, np.nan)) == 0


@pytest.mark.parametrize(
    "seed",
    [pytest.param(45, marks=pytest.mark.long), pytest.param(46, marks=pytest.mark.nightly)],
)
def test_a_faint_scale_is_a_cause_and_the_extended_rig_has_it(seed: int) -> None:
    wave = {"amplitude_rad": 5e-5, "line_order": float(LINES), "phase_rad": -1.1}
    recording = recorded(MODEL.with_effect(SCALE, **wave), seed, slots=SLOTS)
    verdict = verdict_of(find_causes([recording], MODEL, only=(SCALE,)))
    assert verdict.names == (SCALE,)
    assert verdict.effects[SCALE]["line_order"] == LINES
    found = verdict.causes[0].parameters["amplitude_rad"]
    assert found.value == pytest.approx(wave["amplitude_rad"], abs=4.0 * found.standard_error)
    error = verdict.error
    assert error is not None
    assert error.without_causes is not None
    assert error.after < error.without_causes <= 1.001 * error.before
    assert verdict_of(find_causes([recording], MODEL, only=("misalignment",))).names == ()


@pytest.mark.long
def test_a_scale_that_a_round_has_found_is_told_as_it_was_read() -> None:
    """Two counts: a round finds it, a rival may take its confidence; the line leaves no doubt."""
    wave = {"amplitude_rad": 2e-4, "line_order": float(LINES), "phase_rad": 0.4}
    recording = recorded(MODEL.with_effect(SCALE, **wave), 47, slots=SHORT)
    finding = find_causes([recording], MODEL, only=(SCALE,))
    assert any(c.effect == SCALE for played in finding.rounds for c in played.contenders)
    assert finding.named == ()
    (one,) = verdict_of(finding).causes
    found = one.parameters["amplitude_rad"]
    assert one.confidence > 0.95
    assert found.value == pytest.approx(wave["amplitude_rad"], abs=4.0 * found.standard_error)
    assert found.standard_error < 1e-5
    order = one.parameters["line_order"]
    assert (order.value, order.standard_error, order.unit) == (LINES, 0.0, "1")
