"""A cause that takes the place of one that was not asked: its name does not stand."""

import pytest

from servo_bench.diagnosis.judging.judgement import verdict_of
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.diagnosis.searching.letting_go import stands_at_its_end
from servo_bench.diagnosis.searching.unknowns import nuisances
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, recorded

MODEL = Model(NOMINAL)
RUBS = {"torque_nm": 0.012}


@pytest.mark.parametrize(
    ("only", "named"),
    [
        (("thermal_friction",), ()),
        (("thermal_friction", "coulomb"), ("coulomb",)),
        (("coulomb",), ("coulomb",)),
    ],
)
def test_a_neighbour_of_what_is_not_asked_has_no_name(
    only: tuple[str, ...], named: tuple[str, ...]
) -> None:
    """Constant friction is one that warms slowly, where it may not be more than every rig's."""
    seen = recorded(MODEL.with_effect("coulomb", **RUBS), 71, slots=1000)
    finding = find_causes([seen], MODEL, only=only)
    told = verdict_of(finding)
    assert told.names == named, told.sentence
    assert told.verdict == ("named" if named else "unknown")
    assert [doubt.instead for doubt in finding.doubts] == ([] if named else [("coulomb",)])
    assert named or "coulomb" in told.sentence


def test_a_number_is_held_back_at_either_end_of_a_band() -> None:
    band = {u.effect: u for u in nuisances(0.1, 0.02)}
    damping, inertia = band["viscous"], band["inertia_error"]
    assert stands_at_its_end(damping, damping.high)
    assert not stands_at_its_end(damping, 0.0)
    assert stands_at_its_end(inertia, inertia.low)
    assert not stands_at_its_end(inertia, 0.5 * inertia.low)
