"""`analyse` end to end on a played rig with a known truth, and on everything that spoils one."""

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.errors import BenchError, FitError, RecordingError
from servo_bench.excitation.experiment import Phase
from servo_bench.kernels.analysis import Analysis, analyse
from servo_bench.kernels.predict import vaf_percent
from servo_bench.recording.recording import MISSING, Event, Recording
from servo_bench.rig import load_rig
from tests.played_rig import Rig, experiment, recording_of, rows_of

PERIOD = 16383
START = 100 + 256  # standstill and lead-in come before the identification


@pytest.fixture(scope="module")
def played() -> Recording:
    return Rig().record(experiment())


@pytest.fixture(scope="module")
def analysis(played: Recording) -> Analysis:
    return analyse(played)


def test_the_papers_experiment_explains_what_the_study_says(analysis: Analysis) -> None:
    """Medians over four draws of the fresh commands."""
    seeds = [analyse(Rig().record(experiment(seed=seed))).numbers() for seed in (2, 3, 4)]
    runs = [analysis.numbers(), *seeds]
    order1 = np.median([run["vaf_fresh_order1_percent"] for run in runs])
    order3 = np.median([run["vaf_fresh_order3_percent"] for run in runs])
    assert order1 == pytest.approx(90.6, abs=0.5)
    assert order3 == pytest.approx(95.45, abs=0.5)
    assert analysis.numbers()["vaf_same_order3_percent"] == pytest.approx(95.8, abs=0.5)


def test_the_energies_are_those_of_a_play(analysis: Analysis) -> None:
    order1, order2, order3 = analysis.energy_percent
    assert order1 == pytest.approx(90.6, abs=0.5)
    assert order3 == pytest.approx(4.85, abs=0.5)
    assert order2 < 0.05
    assert analysis.odd_percent + analysis.even_percent < 100.0


def test_a_flawless_run_has_no_flags_and_plain_json(analysis: Analysis) -> None:
    numbers = json.loads(json.dumps(analysis.numbers(), allow_nan=False))
    assert numbers["flags"] == []
    assert numbers["run"]["missed_slots"] == 0
    assert (numbers["delay_periods"], numbers["timebase"]) == (0, "device")
    assert numbers["collision_free_memory"] == numbers["memory"] == 21


@pytest.mark.parametrize("delay", [1, 2, 5])
def test_a_delayed_drive_has_the_same_kernels(analysis: Analysis, delay: int) -> None:
    late = analyse(Rig(delay_slots=delay).record(experiment()))
    assert late.delay_periods == delay
    np.testing.assert_allclose(late.kernels.c1, analysis.kernels.c1, atol=1e-3)
    np.testing.assert_allclose(late.kernels.c3, analysis.kernels.c3, atol=1e-3)
    assert late.numbers()["vaf_fresh_order3_percent"] == pytest.approx(
        analysis.numbers()["vaf_fresh_order3_percent"], abs=0.05
    )


def test_a_smaller_gap_is_explained_better(analysis: Analysis) -> None:
    numbers = analyse(Rig(gap_rad=float(np.radians(0.72))).record(experiment())).numbers()
    assert numbers["vaf_fresh_order1_percent"] == pytest.approx(96.4, abs=0.5)
    assert numbers["vaf_fresh_order3_percent"] == pytest.approx(98.3, abs=0.5)


def test_without_a_gap_the_linear_kernel_is_everything() -> None:
    rig = Rig(gap_rad=0.0, counts_per_revolution=None)
    found = analyse(rig.record(experiment("15341", memory=18)))
    validation = found.validation
    assert validation is not None
    assert validation.velocity.vaf_order1_percent > 99.9
    assert found.energy_percent[2] < 0.05
    assert validation.angle_error_order1_rms_rad < 0.05 * validation.angle_rad.std()


def test_a_rig_that_differs_between_directions_shows_in_the_even_order() -> None:
    rig = Rig(velocity_law=lambda v: v + 0.1 * v**2)
    mirrored = Rig(velocity_law=lambda v: v - 0.1 * v**2)
    found, other = (analyse(r.record(experiment())) for r in (rig, mirrored))
    assert found.even_percent > 3.0
    np.testing.assert_allclose(other.kernels.c2, -found.kernels.c2, atol=0.02)
    assert found.numbers()["vaf_fresh_order3_percent"] > 95.0


def test_the_noise_ceiling_is_the_share_that_noise_takes() -> None:
    noise_rad = 2e-3
    recording = Rig(noise_rad=noise_rad, counts_per_revolution=None).record(experiment(periods=2))
    found = analyse(recording)
    assert found.noise_rad_s == pytest.approx(noise_rad * np.sqrt(2.0) / 0.008, rel=0.25)
    assert 93.0 < found.noise_ceiling_percent < 97.0
    assert found.kernels.periods == 2
    assert found.kernels.standard_error == pytest.approx(
        noise_rad * np.sqrt(2.0) / 0.008 / np.sqrt(2 * PERIOD), rel=0.05
    )
    validation = found.validation
    assert validation is not None
    assert validation.velocity.vaf_order3_percent < found.noise_ceiling_percent
    noiseless = analyse(Rig(counts_per_revolution=None).record(experiment())).identification
    left = np.var(found.identification.measured - noiseless.measured)
    assert left == pytest.approx((noise_rad / 0.008) ** 2, rel=0.05)  # half: the mean of two


def test_an_encoder_that_stands_still_has_the_noise_of_its_steps(played: Recording) -> None:
    rig = load_rig("rigs/paper.toml")
    angles = np.random.default_rng(6).uniform(0.0, 1.0, 100_000)
    step_rad = 2.0 * np.pi / 65536
    rounding = np.floor(angles / step_rad) * step_rad - angles
    on_the_drive = load_rig("rigs/modbus-tcp.toml")
    assert on_the_drive.load_counts_per_revolution == 65536
    for known in (rig, on_the_drive, None):  # of data from elsewhere by what they show
        found = analyse(replace(played, rig=known))
        assert found.noise_rad_s == pytest.approx(np.std(np.diff(rounding)) / 0.008, rel=0.02)


def test_the_angle_is_the_integral_of_the_predicted_velocity(analysis: Analysis) -> None:
    validation = analysis.validation
    assert validation is not None
    n = validation.velocity.measured.size
    assert validation.angle_rad.shape == validation.time_s.shape == (n + 1,)
    np.testing.assert_allclose(
        np.diff(validation.angle_order3_rad), validation.velocity.order3 * 0.008, atol=1e-12
    )
    assert validation.angle_order3_rad[0] == validation.angle_rad[0]
    assert 0.0 < validation.angle_error_order3_rms_rad < np.radians(2.0)


def test_predictions_take_commands_from_before_the_phase(played: Recording) -> None:
    """Spoiling what the load did in the validation leaves the predicted velocity as it was."""
    rows = rows_of(played)
    fresh = np.flatnonzero(rows["phase"] == Phase.VALIDATION)[1:]  # [0] ends the last increment
    rows["load_angle_rad"][fresh] = rows["load_angle_rad"][fresh][::-1]
    spoilt = analyse(recording_of(rows, played.experiment)).validation
    whole = analyse(played).validation
    assert spoilt is not None
    assert whole is not None
    np.testing.assert_allclose(spoilt.velocity.order3, whole.velocity.order3, atol=1e-12)
    early = vaf_percent(whole.velocity.measured[:15], whole.velocity.order3[:15])
    assert early > 90.0  # it would not be, had the phase been taken to begin from rest


def test_device_times_bring_a_jittering_run_closer_to_the_punctual_one(
    analysis: Analysis,
) -> None:
    recording = Rig(ask_jitter_s=1e-3, counts_per_revolution=None).record(experiment())
    rows = rows_of(recording)
    rows["device_time_us"] = MISSING
    blind = analyse(recording_of(rows, recording.experiment))
    told = analyse(recording)
    assert (told.timebase, blind.timebase) == ("device", "nominal")
    punctual = analysis.identification.measured
    judged = told.identification.judged & blind.identification.judged
    errors = [np.var((run.identification.measured - punctual)[judged]) for run in (told, blind)]
    assert errors[0] < 0.85 * errors[1]
    assert told.quality.ask_jitter_rms_s == pytest.approx(1e-3 * 0.853, rel=0.05)


def test_a_device_clock_that_runs_fast_changes_nothing(played: Recording) -> None:
    rows = rows_of(played)
    rows["device_time_us"] = np.rint(rows["device_time_us"] * 1.01)
    fast = analyse(recording_of(rows, played.experiment))
    np.testing.assert_allclose(fast.kernels.c1, analyse(played).kernels.c1, atol=1e-3)


def test_a_device_clock_that_begins_again_changes_nothing(played: Recording) -> None:
    """Object 0x1013 has 32 bits of microseconds: 71.6 minutes."""
    rows = rows_of(played)
    halfway = int(rows["device_time_us"][rows.size // 2])
    rows["device_time_us"] = (rows["device_time_us"] - halfway) % (1 << 32)
    again = analyse(recording_of(rows, played.experiment))
    np.testing.assert_array_equal(again.kernels.c1, analyse(played).kernels.c1)


def test_a_few_missing_slots_are_bridged_and_said(played: Recording, analysis: Analysis) -> None:
    rng = np.random.default_rng(4)
    lost = rng.choice(np.arange(START, len(played) - 1), 20, replace=False)
    rows = np.delete(rows_of(played), lost)
    silent = rng.choice(rows.size, 15, replace=False)
    rows["load_angle_rad"][silent] = np.nan
    found = analyse(recording_of(rows, played.experiment))
    assert found.quality.missed_slots == 20
    assert found.quality.missing_encoder_answers == 15
    assert "35 load angles were missing (20 whole slots)" in found.flags[0]
    np.testing.assert_allclose(found.kernels.c1, analysis.kernels.c1, atol=0.02)
    assert found.numbers()["vaf_fresh_order3_percent"] > 95.0


def test_holes_in_the_run_cost_their_own_samples_and_nothing_else(analysis: Analysis) -> None:
    whole = experiment()
    rng = np.random.default_rng(8)
    holes = np.sort(rng.choice(np.arange(START, whole.schedule().slots - 60), 40, replace=False))
    found = analyse(Rig(holes=tuple(holes.tolist())).record(whole))
    assert found.quality.missed_slots == 40
    assert found.validation is not None
    assert analysis.validation is not None
    assert (
        0.85 < found.validation.velocity.judged.mean() < 1.0
    )  # what a hole spoils is not judged, and only that
    for got, expected in (
        (found.identification.vaf_order3_percent, analysis.identification.vaf_order3_percent),
        (
            found.validation.velocity.vaf_order3_percent,
            analysis.validation.velocity.vaf_order3_percent,
        ),
    ):
        assert got == pytest.approx(expected, abs=0.15)
    np.testing.assert_allclose(found.kernels.c1, analysis.kernels.c1, atol=0.01)
    assert any("count neither for the kernels" in flag for flag in found.flags)


def test_slots_can_be_missing_where_a_phase_begins(played: Recording, analysis: Analysis) -> None:
    rows = np.delete(rows_of(played), [START, START + 1, START + PERIOD])
    for experiment_known in (True, False):
        recording = recording_of(rows, played.experiment if experiment_known else None)
        found = analyse(recording, polynomial="40473", memory=21)
        np.testing.assert_allclose(found.kernels.c1, analysis.kernels.c1, atol=0.01)


def test_a_recording_without_its_experiment_needs_only_the_polynomial(
    played: Recording, analysis: Analysis
) -> None:
    foreign = replace(
        played,
        experiment=None,
        channels={
            name: played[name] for name in ("phase", "velocity_command_rad_s", "load_angle_rad")
        },
    )
    found = analyse(foreign, polynomial="40473")
    assert found.kernels.memory == 21
    assert found.timebase == "nominal"
    np.testing.assert_allclose(found.kernels.c3, analysis.kernels.c3, atol=1e-12)
    assert found.numbers()["run"]["lateness_max_s"] is None
    with pytest.raises(RecordingError, match="Name its polynomial, in octal"):
        analyse(foreign)


@pytest.mark.parametrize("after", [0, 1, 2])
def test_a_recording_that_ends_with_the_period_is_used_from_the_lead_in_on(
    played: Recording, analysis: Analysis, after: int
) -> None:
    """The response to the last chip has no end yet: one chip of the lead-in stands in for it."""
    cut = replace(recording_of(rows_of(played)[: START + PERIOD + after], None), cut=True)
    found = analyse(replace(cut, experiment=played.experiment))
    np.testing.assert_allclose(found.kernels.c1, analysis.kernels.c1, atol=2e-3)
    assert found.validation is None
    assert found.numbers()["vaf_fresh_order3_percent"] is None
    assert len(found.flags) == 2


def test_a_cut_run_uses_the_periods_that_are_whole() -> None:
    recording = Rig().record(experiment("15341", memory=18, periods=3))
    cut = recording_of(rows_of(recording)[: START + 2 * 4095 + 700], recording.experiment)
    found = analyse(cut)
    assert found.kernels.periods == 2


def test_late_and_missing_answers_are_counted(played: Recording) -> None:
    rows = rows_of(played)
    rows["drive_latency_s"] = rows["encoder_latency_s"] = 0.001
    rows["drive_latency_s"][[5, 6]] = 0.009
    rows["drive_latency_s"][7] = np.nan
    rows["lateness_s"][:] = np.linspace(0.0, 1e-3, rows.size)
    recording = replace(
        recording_of(rows, played.experiment), events=(Event(0, "slot skipped", "one"),)
    )
    quality = analyse(recording).quality
    assert (quality.late_answers, quality.missing_drive_answers) == (2, 1)
    assert quality.lateness_p50_s == pytest.approx(5e-4)
    assert quality.lateness_max_s == pytest.approx(1e-3)
    assert quality.events == {"slot skipped": 1}


def _without(channel: str) -> Callable[[Recording], Recording]:
    return lambda r: replace(r, channels={k: v for k, v in r.channels.items() if k != channel})


def _spoilt(spoil: Callable[[NDArray[np.void]], object]) -> Callable[[Recording], Recording]:
    def apply(recording: Recording) -> Recording:
        rows = rows_of(recording)
        spoil(rows)
        return recording_of(rows, recording.experiment)

    return apply


def _cut(rows: int) -> Callable[[Recording], Recording]:
    return lambda r: recording_of(rows_of(r)[:rows], r.experiment)


def _every_50th_lost(rows: NDArray[np.void]) -> None:
    rows["load_angle_rad"][::50] = np.nan


def _never_came(rows: NDArray[np.void]) -> None:
    rows["load_angle_rad"] = np.nan


def _stuck(rows: NDArray[np.void]) -> None:
    rows["load_angle_rad"] = 1.25


def _drifting(rows: NDArray[np.void]) -> None:
    rows["load_angle_rad"] = np.cumsum(np.random.default_rng(5).normal(size=rows.size)) * 1e-3


def _backwards(rows: NDArray[np.void]) -> None:
    rows["slot"][400:] -= 10


def _no_commands(rows: NDArray[np.void]) -> None:
    rows["velocity_command_rad_s"] = np.nan


@pytest.mark.parametrize(
    ("spoil", "error", "says"),
    [
        (_cut(START + PERIOD - 1), RecordingError, "16382 slots .* has 16383.*Record at least"),
        (_cut(START - 10), RecordingError, "0 slots of identification"),
        (_cut(1), RecordingError, "has 1 rows"),
        (_without("load_angle_rad"), RecordingError, "no channel load_angle_rad: it has asked_ns"),
        (_without("velocity_command_rad_s"), RecordingError, "no channel velocity_command_rad_s"),
        (_spoilt(_every_50th_lost), RecordingError, r"\(2.0 %\): at most 1 % can be bridged"),
        (_spoilt(_never_came), RecordingError, "not one of 24931 load angles came"),
        (_spoilt(_stuck), FitError, "does not answer the commands"),
        (_spoilt(_drifting), FitError, "does not answer the commands.*Check that the load encoder"),
        (_spoilt(_backwards), RecordingError, "slots must rise"),
        (_spoilt(_no_commands), FitError, "100.0 % of them differ"),
    ],
)
def test_a_recording_that_cannot_be_analysed_is_refused(
    played: Recording,
    spoil: Callable[[Recording], Recording],
    error: type[BenchError],
    says: str,
) -> None:
    with pytest.raises(error, match=says):
        analyse(spoil(played))


def test_another_polynomial_than_the_played_one_is_refused(played: Recording) -> None:
    with pytest.raises(FitError, match=r"are not the M-sequence of 50523 .* of them differ"):
        analyse(played, polynomial="50523")


def test_a_memory_that_the_polynomial_cannot_resolve_is_refused(played: Recording) -> None:
    with pytest.raises(FitError, match=r"memory 22 .* of at most 21"):
        analyse(played, memory=22)


def test_phases_that_nobody_tells_are_asked_for(played: Recording) -> None:
    with pytest.raises(RecordingError, match="convert yours with a channel `phase`"):
        analyse(_without("phase")(replace(played, experiment=None)), polynomial="40473")
