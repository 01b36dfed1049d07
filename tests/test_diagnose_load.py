"""A load of its own mass: how it goes through its gap is torque over mass, and both are found."""

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import evidence_of
from servo_bench.diagnosis.searching.bounces import MOST, bounces
from servo_bench.diagnosis.searching.coasting import coasting
from servo_bench.diagnosis.searching.finding import Finding, find_causes
from servo_bench.diagnosis.searching.unknowns import Unknown, put_all
from sim_rig.errors import EffectError
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, recorded

MODEL = Model(NOMINAL)
MASS_KG_M2 = 0.03 * NOMINAL.inertia_kg_m2
FRICTION_NM = 5e-4
SLOTS = 900


def light_load(friction_nm: float) -> Model:
    face = {"compliance_rad_per_nm": 2e-3, "damping_s": 1e-4, "load_inertia_kg_m2": MASS_KG_M2}
    return MODEL.with_effect("contact", **face).with_effect("load_friction", torque_nm=friction_nm)


def asked(hidden: Model, seed: int, effect: str) -> Finding:
    return find_causes([recorded(hidden, seed, slots=SLOTS)], MODEL, only=(effect,))


@pytest.mark.long
def test_friction_and_mass_of_a_load_that_comes_to_rest_in_its_gap_are_found() -> None:
    found = asked(light_load(3e-3), 25, "load_friction")
    assert [n.effect for n in found.named] == ["load_friction", "contact"]
    effects = found.final.model.effects
    assert effects["load_friction"].torque_nm == pytest.approx(3e-3, rel=0.05)
    assert effects["contact"].load_inertia_kg_m2 == pytest.approx(MASS_KG_M2, rel=0.05)


@pytest.mark.long
def test_a_weight_that_moves_a_light_load_is_found_beside_its_friction() -> None:
    """Where it hangs to hundredths, how heavy it is to a fifth: seven seconds of a load that
    bounces in its gap lead a search into one of several valleys (eight seeds: 0.81 to 1.00)."""
    weight = {"torque_nm": 2.5e-3, "phase_rad": 1.9}
    hidden = light_load(FRICTION_NM).with_effect("gravity_imbalance", **weight)
    finding = asked(hidden, 25, "gravity_imbalance")
    assert [n.effect for n in finding.named] == ["gravity_imbalance", "contact"]
    found = finding.final.model.effects
    assert found["gravity_imbalance"].torque_nm == pytest.approx(2.5e-3, rel=0.2)
    assert found["gravity_imbalance"].phase_rad == pytest.approx(1.9, abs=0.05)
    assert found["load_friction"].torque_nm == pytest.approx(FRICTION_NM, rel=0.2)


def test_a_load_that_bounces_on_faces_of_its_own_law_may_be_missed_and_its_motor_may_not() -> None:
    hidden = light_load(FRICTION_NM).with_effect("gravity_imbalance", torque_nm=2.5e-3)
    seen = evidence_of([recorded(hidden, 27, slots=SLOTS)], MODEL, block="loop")
    for thrown, least in ((hidden, 0.5), (coasting(MODEL, 700.0), 0.001)):
        missed = dict(zip(seen.names, bounces(seen, thrown) / seen.allowed, strict=True))
        assert least < missed["twist over 48 ms"] <= MOST
        assert max(missed["motor velocity"], missed["torque"]) < 0.3
    np.testing.assert_array_equal(bounces(seen, MODEL), 0.0)


def test_what_a_mass_carries_in_proportion_keeps_its_ratio_and_its_sign() -> None:
    rig = light_load(FRICTION_NM).with_effect("load_torque", torque_nm=-0.01)
    both = "load_friction.torque_nm load_torque.torque_nm"
    mass = Unknown(
        *("contact", "load_inertia_kg_m2", 0.0, np.inf, 1e-6), carries=both, in_proportion=True
    )
    heavier = put_all(rig, (mass,), (2.0 * MASS_KG_M2,)).effects
    assert heavier["load_friction"].torque_nm == pytest.approx(2.0 * FRICTION_NM)
    assert heavier["load_torque"].torque_nm == pytest.approx(-0.02)
    alone = put_all(rig.without("load_torque"), (mass,), (2.0 * MASS_KG_M2,)).effects
    assert "load_torque" not in alone


def test_masses_that_are_put_anew_need_make_a_rig_at_the_end_only() -> None:
    half = 0.5 * NOMINAL.inertia_kg_m2
    face = {"compliance_rad_per_nm": 2e-3, "load_inertia_kg_m2": half}
    rig = MODEL.with_effect("contact", **face)
    coupled = {"compliance_rad_per_nm": 1e-3, "load_inertia_kg_m2": 0.2 * half}
    rig = rig.with_effect("coupling_compliance", **coupled)
    coupling, behind = (
        Unknown(effect, "load_inertia_kg_m2", 0.0, np.inf, 1e-6)
        for effect in ("coupling_compliance", "contact")
    )
    changed = put_all(rig, (coupling, behind), (1.5 * half, 0.1 * half)).effects
    assert changed["coupling_compliance"].load_inertia_kg_m2 == 1.5 * half
    with pytest.raises(EffectError, match="inertia"):
        put_all(rig, (coupling,), (1.5 * half,))
