"""Several estimators on one recording: what counts, what is a model, and what cannot be fitted."""

import numpy as np
import pytest

from servo_bench.estimators.least_squares import LeastSquaresFit
from servo_bench.estimators.study import Study, study, training_of
from servo_bench.excitation.sequences import InverseRepeat, MultiAmplitude
from servo_bench.kernels.analysis import analyse
from servo_bench.kernels.labels import Label
from servo_bench.recording.recording import Recording
from servo_bench.report.distortion_words import distortion_sentences
from servo_bench.report.estimator_tables import estimator_rows, simulated_table
from tests.played_rig import Rig, experiment

AMPLITUDE = float(np.radians(150.0))


def _short(rig: Rig | None = None) -> Recording:
    return (rig or Rig()).record(experiment("2011", memory=10, fresh=700))


@pytest.fixture(scope="module")
def found() -> Study:
    recording = _short()
    return study(recording, analyse(recording), ("correlation", "regularised", "play"))


def test_the_analysis_own_kernels_are_the_papers_method(found: Study) -> None:
    validation = found.analysis.validation
    assert validation is not None
    assert found.fits[0].vaf_fresh_percent == pytest.approx(
        validation.velocity.vaf_order3_percent, abs=1e-6
    )


def test_the_best_is_by_fresh_data_and_beats_the_papers_method(found: Study) -> None:
    by_name = {fit.name: fit for fit in found.fits}
    assert found.best is max(found.fits, key=lambda fit: fit.vaf_fresh_percent)
    regularised, papers = by_name["regularised"], by_name["correlation"]
    assert regularised.vaf_fresh_percent > papers.vaf_fresh_percent
    assert found.posterior is not None


def test_the_grey_box_is_the_reference_and_no_row_of_its_own_table(found: Study) -> None:
    table = simulated_table(found)
    assert table is not None
    assert [name for name, _ in table.rows] == ["correlation", "regularised", "play"]
    assert "same period" not in table.inputs
    assert estimator_rows(found)[-1].remark.startswith("fitted for the table below")


def test_an_estimator_that_cannot_be_fitted_is_kept_with_its_reason() -> None:
    """Its memory of 14 samples is beyond what this short sequence can resolve."""
    recording = _short()
    found = study(recording, analyse(recording), ("least-squares",))
    refused = found.fits[0]
    assert refused.predictor is None
    assert "sums of others on this input" in refused.refused
    assert found.best is None
    assert found.numbers()["estimators"]["least-squares"]["vaf_fresh_percent"] is None
    assert estimator_rows(found)[0].remark.startswith("not fitted: ")


def test_inverse_repeat_and_amplitudes_are_trainings_too() -> None:
    plan = experiment("2011", memory=10, fresh=700)
    mirrored = InverseRepeat(kind="inverse-repeat", polynomial="2011", amplitude_rad_s=AMPLITUDE)
    several = MultiAmplitude(
        kind="multi-amplitude",
        polynomial="2011",
        amplitudes_rad_s=(AMPLITUDE, 2 * AMPLITUDE),
        settling=100,
    )
    for identification, samples, gone in ((mirrored, 2046, 0), (several, 2 * 1023 + 100, 1)):
        recording = Rig(delay_slots=2).record(
            plan.model_copy(update={"identification": identification})
        )
        analysis = analyse(recording)
        training = training_of(recording, analysis)
        assert training.inputs.size == samples
        assert training.polynomial is None
        result = study(recording, analysis, ("grey-box",))
        assert result.fits[0].vaf_fresh_percent > 99.5
        assert (result.labels.count(Label.IDENTIFIABLE) > 45 + 120) == bool(gone)


def test_a_memory_that_is_asked_for_is_every_estimators() -> None:
    recording = _short()
    analysis = analyse(recording, memory=6)
    for memory in (4, 6):
        predictor = study(recording, analysis, ("least-squares",), memory).fits[0].predictor
        assert isinstance(predictor, LeastSquaresFit)
        assert predictor.memory == memory


def test_what_kind_of_nonlinearity_is_said_in_words() -> None:
    plan = experiment("15341", memory=10, fresh=300)
    play = analyse(Rig().record(plan))
    lopsided = analyse(Rig(gap_rad=0.0, velocity_law=lambda v: v + 0.1 * v**2).record(plan))
    assert "is odd" in distortion_sentences(play)[0]
    assert "No difference between the directions" in distortion_sentences(play)[0]
    assert "even: something differs between the directions" in distortion_sentences(lopsided)[0]
    assert "by the standstill" in distortion_sentences(play)[2]
    repeated = analyse(Rig(noise_rad=1e-3).record(experiment("2011", memory=8, periods=3)))
    assert "by the spread between 3 periods" in distortion_sentences(repeated)[2]


@pytest.mark.parametrize("polynomial", ["4005", "4027", "4445", "5205"])
@pytest.mark.parametrize("gap_rad", [0.02, 0.05])
def test_what_is_alike_in_both_directions_is_never_called_even(
    polynomial: str, gap_rad: float
) -> None:
    """Aliases of orders 5 and above are few and large: a median of them is no measure of energy."""
    analysis = analyse(Rig(gap_rad=gap_rad).record(experiment(polynomial, memory=10, fresh=300)))
    assert "No difference between the directions" in distortion_sentences(analysis)[0]
