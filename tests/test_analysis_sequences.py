"""`analyse` on the sequences beyond the plain one: the same rig, so the same kernels."""

from dataclasses import replace

import numpy as np
import pytest

from servo_bench.errors import FitError, RecordingError
from servo_bench.excitation.experiment import Phase
from servo_bench.excitation.sequences import (
    FieldSequence,
    FromRecording,
    InverseRepeat,
    MSequence,
    MultiAmplitude,
    Periodic,
    inverse_repeat,
)
from servo_bench.kernels.analysis import Analysis, analyse
from servo_bench.kernels.labels import Label
from servo_bench.kernels.separation import extract_inverse_repeat
from servo_bench.recording.recording import Recording
from tests.played_rig import Rig, experiment, recording_of, rows_of

AMPLITUDE = float(np.radians(150.0))
START = 100 + 256


def _played(identification: Periodic, rig: Rig | None = None, memory: int = 12) -> Recording:
    plan = experiment("15341", memory=memory, fresh=1500)
    return (rig or Rig()).record(plan.model_copy(update={"identification": identification}))


def _inverse_repeat(**more: float) -> InverseRepeat:
    return InverseRepeat(
        kind="inverse-repeat", polynomial="15341", amplitude_rad_s=AMPLITUDE, **more
    )


def _levels(*shares: float) -> MultiAmplitude:
    return MultiAmplitude(
        kind="multi-amplitude",
        polynomial="15341",
        amplitudes_rad_s=tuple(share * AMPLITUDE for share in shares),
    )


def _field(field: int, degree: int) -> FieldSequence:
    values = {"kind": "field", "field": field, "degree": degree, "amplitude_rad_s": AMPLITUDE}
    return FieldSequence.model_validate(values)


@pytest.fixture(scope="module")
def plain() -> Analysis:
    return analyse(_played(MSequence(polynomial="15341", amplitude_rad_s=AMPLITUDE)))


@pytest.mark.parametrize(("polynomial", "memory"), [("12147", 19), ("15341", 18)])
def test_inverse_repeat_resolves_the_memory_that_a_search_names(
    polynomial: str, memory: int
) -> None:
    """A plant of four products, the longest lags among them: each coefficient as it was put in."""
    chips = inverse_repeat(polynomial).astype(float)
    end, second = memory - 1, memory - 2
    put_in = {(2,): 1.5, (0, end): -0.7, (0, 5, end): 0.4, (1, second, end): 0.9}
    lagged = {lag: np.roll(chips, lag) for lags in put_in for lag in lags}
    answer = sum(
        size * np.prod([lagged[lag] for lag in lags], axis=0) for lags, size in put_in.items()
    )
    found = extract_inverse_repeat(answer, polynomial, 1.0, memory)
    measured = (found.c1, found.c2, found.c3)
    for kernel, order in zip(measured, (1, 2, 3), strict=True):
        told = {tuple(map(int, at)): kernel[tuple(at)] for at in np.argwhere(np.abs(kernel) > 0.01)}
        assert told == pytest.approx({k: v for k, v in put_in.items() if len(k) == order}, abs=0.01)
    with pytest.raises(FitError, match=f"from {memory + 1} samples on"):
        extract_inverse_repeat(answer, polynomial, 1.0, memory + 1)


def test_without_validation_the_kernels_are_those_of_the_largest_amplitude() -> None:
    recording = _played(_levels(0.5, 1.0))
    end = int(np.flatnonzero(recording["phase"] == Phase.VALIDATION)[0])
    cut = replace(recording, channels={k: v[:end] for k, v in recording.channels.items()})
    assert analyse(cut).kernels.amplitude == pytest.approx(AMPLITUDE)


def test_inverse_repeat_finds_the_kernels_of_the_plain_sequence(plain: Analysis) -> None:
    found = analyse(_played(_inverse_repeat(), Rig(delay_slots=2)))
    assert (found.played.kind, found.delay_periods) == ("inverse-repeat", 2)
    scatter = max(found.kernels.scatter, plain.kernels.scatter)
    assert np.abs(found.kernels.c1 - plain.kernels.c1).max() < 5.0 * scatter
    assert found.even_percent < 0.05  # a play is odd, and no odd order can alias into an even one
    assert found.numbers()["vaf_fresh_order3_percent"] == pytest.approx(
        plain.numbers()["vaf_fresh_order3_percent"], abs=0.5
    )


@pytest.mark.parametrize(("field", "degree"), [(3, 8), (5, 4)])
def test_more_levels_are_read_as_far_as_they_resolve_and_the_rest_is_said(
    field: int, degree: int
) -> None:
    recording = _played(_field(field, degree))
    with pytest.raises(FitError, match=r"memory 12 is beyond .* a memory of 1 to 8"):
        analyse(recording)
    found = analyse(recording, memory=8)
    numbers = found.numbers()
    assert (numbers["levels"], numbers["collision_free_memory"], numbers["memory"]) == (field, 8, 8)
    assert any("8 of the experiment's 12 samples" in flag for flag in found.flags)
    assert any("is aliased into these kernels" in flag for flag in found.flags)
    assert numbers["vaf_same_order3_percent"] > numbers["vaf_same_order1_percent"]
    assert found.played.labels(8).count(Label.SUM_ONLY) == (16 if field == 3 else 0)


def test_several_amplitudes_tell_g1_from_the_folded_diagonals(plain: Analysis) -> None:
    found = analyse(_played(_levels(0.5, 1.0, 2.0)))
    separated = found.separated
    assert separated is not None
    assert found.kernels.amplitude == pytest.approx(AMPLITUDE)  # the validation's
    np.testing.assert_allclose(found.kernels.c1, plain.kernels.c1, atol=1e-2)
    assert separated.amplitudes == pytest.approx([AMPLITUDE / 2, AMPLITUDE, AMPLITUDE * 2])
    assert np.abs(separated.folded).max() > 3.0 * separated.errors[1]
    assert found.played.labels(12, found.amplitudes).order1[0] == Label.IDENTIFIABLE


def test_a_cut_run_at_several_amplitudes_uses_those_that_are_whole() -> None:
    recording = _played(_levels(1.0, 2.0, 0.5))
    rows = rows_of(recording)
    whole = START + 3 * (256 + 4095) - 400
    found = analyse(replace(recording_of(rows[:whole], recording.experiment), cut=True))
    assert found.amplitudes == 2
    assert any("1 of 3 amplitudes were not played whole" in flag for flag in found.flags)
    short = recording_of(rows[: START + 4351], recording.experiment)
    with pytest.raises(RecordingError, match="1 whole plays at one amplitude of the 3"):
        analyse(short)


def test_a_bias_is_taken_off_and_said() -> None:
    found = analyse(_played(_inverse_repeat(bias_rad_s=0.5)))
    assert found.bias_rad_s == pytest.approx(0.5)
    assert found.numbers()["bias_rad_s"] == pytest.approx(0.5)


@pytest.mark.parametrize("kind", ["m-sequence", "inverse-repeat"])
def test_repeats_tell_the_noise_and_the_standard_error(kind: str) -> None:
    noise_rad, periods = 2e-3, 3
    sequence: dict[str, Periodic] = {
        "m-sequence": MSequence(polynomial="2011", amplitude_rad_s=AMPLITUDE, periods=periods),
        "inverse-repeat": InverseRepeat(
            kind="inverse-repeat", polynomial="2011", amplitude_rad_s=AMPLITUDE, periods=periods
        ),
    }
    rig = Rig(noise_rad=noise_rad, counts_per_revolution=None)
    found = analyse(_played(sequence[kind], rig, memory=7))
    sample = noise_rad * np.sqrt(2.0) / 0.008
    chips = found.played.chips
    assert found.repeat_noise_rad_s == pytest.approx(sample, rel=0.05)
    expected = sample / np.sqrt(periods * float(chips @ chips))
    assert found.kernels.standard_error == pytest.approx(expected, rel=0.15)


def test_another_sequence_than_the_experiment_says_is_refused() -> None:
    recording = _played(_inverse_repeat())
    plain = recording.experiment
    assert plain is not None
    claimed = plain.model_copy(update={"identification": _field(3, 8)})
    with pytest.raises(FitError, match=r"are not the field sequence of .* of them differ"):
        analyse(recording_of(rows_of(recording), claimed))


def test_commands_from_a_recording_identify_nothing() -> None:
    replayed = _played(FromRecording(commands_rad_s=(0.1, 0.2, 0.1)))
    with pytest.raises(RecordingError, match="no kernel can be told from them"):
        analyse(replayed)


def test_an_angle_where_an_angle_of_an_angle_is_recorded_is_refused() -> None:
    """The channel holds the integral of the load's angle: its increments are positions."""
    rows = rows_of(_played(MSequence(polynomial="15341", amplitude_rad_s=AMPLITUDE)))
    rows["load_angle_rad"] = np.cumsum(rows["load_angle_rad"]) * 0.008
    plan = experiment("15341", memory=12, fresh=1500)
    with pytest.raises(FitError, match=r"an angle .a velocity summed up. or a drift"):
        analyse(recording_of(rows, plan))


@pytest.mark.parametrize(("field", "degree"), [(3, 7), (5, 4)])
def test_orders_of_more_levels_share_the_variance_that_there_is(field: int, degree: int) -> None:
    analysis = analyse(_played(_field(field, degree), memory=4), memory=4)
    shares = np.array(analysis.energy_percent)
    assert np.all(shares >= 0.0)
    assert shares.sum() <= 100.0
    assert shares.sum() == pytest.approx(analysis.identification.vaf_order3_percent, abs=5.0)
    assert not any("amplitude of the identification" in flag for flag in analysis.flags)
