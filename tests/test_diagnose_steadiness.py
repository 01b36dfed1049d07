"""A number that changes while it is recorded is told from one that is only wrong."""

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import evidence_of
from servo_bench.diagnosis.judging.judgement import verdict_of
from servo_bench.diagnosis.judging.steadiness import slope_of
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.unknowns import merged, nuisances, widened
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, recorded

MODEL = Model(NOMINAL)
BAND = nuisances(0.05, NOMINAL.backlash_gap_rad)
NAME, SLOTS = "torque_constant_error.error_fraction", 1200
DROP, WARMING_S = 0.2, 8.0


def fitted(*hidden: Model) -> Found:
    """A K_T that is wrong all the time alike, sought where each of these was recorded in turn."""
    recordings = [recorded(model, 31 + k, slots=SLOTS) for k, model in enumerate(hidden)]
    whole = evidence_of(recordings, MODEL, block="loop")
    own = widened("torque_constant_error", ("error_fraction",), MODEL, 0.1)
    return seek(whole, MODEL, merged(BAND, own), iterations=5)


def test_what_warms_goes_along_the_line_that_is_nearest_to_it() -> None:
    warm = MODEL.with_effect("thermal_torque_constant", drop_fraction=DROP, warming_s=WARMING_S)
    slope = slope_of(fitted(warm), NAME)
    t_s = np.arange(SLOTS) * PERIOD_S
    fall, first = np.polyfit(t_s, -DROP * (1.0 - np.exp(-t_s / WARMING_S)), 1)
    assert slope.is_there
    assert slope.first == pytest.approx(first, abs=0.1 * DROP)
    assert slope.last == pytest.approx(first + fall * t_s[-1], abs=0.1 * DROP)


@pytest.mark.long
def test_a_cause_that_changes_has_no_name_and_the_verdict_says_how_it_changed() -> None:
    warm = MODEL.with_effect("thermal_torque_constant", drop_fraction=DROP, warming_s=WARMING_S)
    finding = find_causes([recorded(warm, 31, slots=SLOTS)], MODEL, only=("torque_constant_error",))
    assert [n.effect for n in finding.named] == ["torque_constant_error"]
    verdict = verdict_of(finding)
    assert (verdict.verdict, verdict.names) == ("unknown", ())
    assert "torque constant error changes while it is recorded" in verdict.sentence


def test_what_is_wrong_all_the_time_alike_is_steady() -> None:
    wrong = MODEL.with_effect("torque_constant_error", error_fraction=-0.1)
    slope = slope_of(fitted(wrong), NAME)
    assert not slope.is_there
    assert slope.first == pytest.approx(slope.last, abs=0.002)
    assert slope.taken < 0.01


def test_a_number_that_is_another_in_the_next_recording_is_not_steady() -> None:
    low, high = 0.02, 0.1
    wrong = (MODEL.with_effect("torque_constant_error", error_fraction=e) for e in (low, high))
    slope = slope_of(fitted(*wrong), NAME)
    assert slope.is_there
    # a line through a step goes beyond both of its ends
    assert slope.first < low
    assert slope.last > high


def test_only_what_was_sought_has_a_slope() -> None:
    with pytest.raises(ValueError, match="cogging"):
        slope_of(fitted(MODEL), "cogging.torque_nm")
