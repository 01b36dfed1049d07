"""What refines Coulomb friction has a name where what it adds is seen, asked beside that or not."""

import pytest

from servo_bench.diagnosis.comparing.evidence import evidence_of
from servo_bench.diagnosis.judging.judgement import verdict_of
from servo_bench.diagnosis.searching.contenders import SLIDING_RAD
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.diagnosis.searching.refining import (
    is_seen_to_warm,
    must_show_itself,
    shows_itself,
)
from servo_bench.diagnosis.searching.seeking import seek
from servo_bench.diagnosis.searching.unknowns import Unknown, nuisances
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, recorded
from tests.trials.drawing import Question
from tests.trials.handing import nominal_rig, straight

MODEL = Model(NOMINAL)
COLD = Unknown("thermal_friction", "cold_torque_nm", 0.0, 0.1, step=2e-3)
WARMING_S = 8.0


@pytest.mark.parametrize("warms", [False, True])
def test_friction_that_warms_is_told_from_one_that_does_not(warms: bool) -> None:
    steady = MODEL.with_effect("coulomb", torque_nm=0.01)
    cold = MODEL.with_effect("thermal_friction", cold_torque_nm=0.01, warming_s=WARMING_S)
    seen = evidence_of([recorded(cold if warms else steady, 41, slots=1500)], MODEL, block="loop")
    band = nuisances(0.05, NOMINAL.backlash_gap_rad)
    base = seek(seen, MODEL, band, iterations=2)
    start = MODEL.with_effect("thermal_friction", cold_torque_nm=5e-3, warming_s=WARMING_S)
    found = seek(seen, start, (*band, COLD), base.sigma, iterations=4)
    assert found.cost < 0.5 * base.cost, "the law takes most of it anyhow"
    assert is_seen_to_warm(seen, base, found) is warms
    assert shows_itself(seen, base, found, "thermal_friction") is warms
    assert shows_itself(seen, base, found, "viscous"), "adds nothing to anything"


@pytest.mark.parametrize(("bristle_rad", "shows"), [(0.5 * SLIDING_RAD, False), (1e-4, True)])
def test_bristles_that_only_slide_are_none(bristle_rad: float, shows: bool) -> None:
    rig = MODEL.with_effect("pre_sliding", torque_nm=0.01, breakaway_angle_rad=bristle_rad)
    seen = evidence_of([recorded(rig, 42, slots=400)], MODEL, block="loop")
    base, found = (seek(seen, model, (), iterations=1) for model in (MODEL, rig))
    assert shows_itself(seen, base, found, "pre_sliding") is shows


@pytest.mark.nightly
def test_plain_friction_has_no_name_of_what_refines_it() -> None:
    """18 mN m in the truth, and none of its own names asked: friction that warms fitted 44 s of it,
    with magnets that warm to make up for what it said too much."""
    question = Question(seed=6270000, kind="removed", effect="coulomb_friction")
    sealed = question.sealed()
    seen, held_out = (straight(question, sealed, take) for take in (0, 1))
    model, without = nominal_rig(question.nominal).model(), question.without(sealed)
    told = verdict_of(find_causes([seen], model, held_out=held_out, without=without))
    assert (told.verdict, told.names) == ("unknown", ())


@pytest.mark.parametrize(
    ("asked", "contend", "must"),
    [
        ({"coulomb", "thermal_friction"}, ["coulomb", "thermal_friction"], False),
        ({"coulomb", "thermal_friction"}, ["thermal_friction"], True),
        ({"thermal_friction", "viscous"}, ["thermal_friction", "viscous"], True),
        ({"thermal_friction"}, ["thermal_friction"], False),
    ],
)
def test_who_faces_plain_friction_need_show_nothing(
    asked: set[str], contend: list[str], must: bool
) -> None:
    """Nor who is alone, and plain friction not asked: a verdict tells what it stands for."""
    assert must_show_itself(asked, contend) is must
