"""A load that was given a mass and a friction of its own, where every rig's own would do."""

import pytest

from servo_bench.diagnosis.comparing.evidence import evidence_of
from servo_bench.diagnosis.searching.coasting import coasting, is_coasting
from servo_bench.diagnosis.searching.finding import nothing_told
from servo_bench.diagnosis.searching.lighter import on_a_light_load
from servo_bench.diagnosis.searching.seeking import seek
from servo_bench.diagnosis.searching.unknowns import Unknown, merged, nuisances
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, recorded

COULOMB_NM, SLOWED_RAD_S2 = 8e-3, 400.0
MODEL = Model(NOMINAL)
BAND = nuisances(0.036, NOMINAL.backlash_gap_rad)
OWN = (
    Unknown("coulomb", "torque_nm", 0.0, 0.1, step=2e-3),
    Unknown("load_friction", "torque_nm", 0.0, 0.1, step=3e-4),
    Unknown("contact", "load_inertia_kg_m2", 1e-7, 2e-4, step=1e-6),
)


def heavier(model: Model, times: float) -> Model:
    """The same load with so many times the mass, friction, and stiffness: in its gap it goes on as
    far, and of the whole friction it has more."""
    contact, own = model.effects["contact"]._asdict(), model.effects["load_friction"].torque_nm
    contact["load_inertia_kg_m2"] *= times
    contact["compliance_rad_per_nm"] /= times
    whole_nm = model.effects["coulomb"].torque_nm + own
    heavy = model.with_effect("contact", **contact)
    heavy = heavy.with_effect("load_friction", torque_nm=times * own)
    return heavy.with_effect("coulomb", torque_nm=whole_nm - times * own)


@pytest.mark.parametrize(
    ("times", "light"), [pytest.param(1.0, True, marks=pytest.mark.long), (50.0, False)]
)
def test_a_load_is_light_where_the_motor_feels_nothing_of_it(times: float, light: bool) -> None:
    rig = coasting(MODEL.with_effect("coulomb", torque_nm=COULOMB_NM), SLOWED_RAD_S2)
    hidden = heavier(rig, times)
    whole = evidence_of([recorded(hidden, 71, slots=900)], MODEL, block="loop")
    begun = heavier(rig, 7.0) if light else hidden
    final = seek(whole, begun, merged(BAND, OWN), iterations=2)
    found, named = on_a_light_load(whole, final, [], BAND, nothing_told)
    assert is_coasting(found.model) == light
    assert named == []
    if light:
        assert found.value("coulomb.torque_nm") == pytest.approx(COULOMB_NM, rel=0.1)
