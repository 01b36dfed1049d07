"""A hidden effect: another hand's plant has a wrong backlash width; the fit must find it.

The truth (tests/truth) shares no equation with the model, its gap is drawn from a seed, and the
seal is opened after the fit. The bounds were fixed from the truth's step halving and friction
before the seeds below were played.
"""

import pytest

from servo_bench.diagnosis.greybox import GreyBoxFit, fit
from servo_bench.excitation.experiment import load_experiment
from servo_bench.rig import load_rig
from tests.truth import hidden

FOUND_WITHIN = 0.05
ERROR_FALLS_TO = 0.6
NULL_GAIN = 0.2  # what the truth's friction and contact, which the model lacks, let the gap absorb


def judged(sealed: hidden.Sealed) -> GreyBoxFit:
    """Fit the gap to a recording of the sealed plant, knowing only the nominal rig."""
    nominal = load_rig("rigs/paper.toml").nominal_values()
    recording = hidden.record(sealed, load_experiment("experiments/demo.toml"), nominal)
    return fit(recording, nominal, ("backlash_gap_rad",))


@pytest.mark.parametrize("seed", [11, 23, 35, 47, 59, 71])
def test_a_hidden_backlash_width_is_found_and_the_held_out_error_falls(seed: int) -> None:
    sealed = hidden.draw(seed)
    nominal = load_rig("rigs/paper.toml").nominal_values()
    found = judged(sealed)
    truth_rad = sealed.open().backlash_gap_rad(nominal)
    assert found.nominal.backlash_gap_rad == pytest.approx(truth_rad, rel=FOUND_WITHIN)
    assert found.held_out_after_rad_s < ERROR_FALLS_TO * found.held_out_before_rad_s


@pytest.mark.parametrize("seed", [7, 8])
def test_where_nothing_is_hidden_the_fit_changes_little_and_gains_nothing(seed: int) -> None:
    nominal = load_rig("rigs/paper.toml").nominal_values()
    found = judged(hidden.nothing(seed))
    assert found.nominal.backlash_gap_rad == pytest.approx(
        nominal.backlash_gap_rad, rel=FOUND_WITHIN
    )
    assert found.gain < NULL_GAIN
