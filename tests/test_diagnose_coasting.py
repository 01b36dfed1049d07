"""A light load that goes on in its gap: not to be taken for something unknown, nor for a cause."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from servo_bench.diagnosis.comparing.evidence import Evidence, evidence_of
from servo_bench.diagnosis.searching import coasting as coasts
from servo_bench.diagnosis.searching import finding
from servo_bench.diagnosis.searching.classes import class_of
from servo_bench.diagnosis.searching.coasting import (
    TAKES_BOTH,
    Face,
    coasting,
    coasting_or_rested,
    given_back,
    is_coasting,
    slowing_rad_s2,
    usual,
    with_coasting,
)
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.diagnosis.searching.gate import misfit
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.unknowns import nuisances, widened
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, recorded

MODEL = Model(NOMINAL)
SLOWED_RAD_S2 = 350.0


def searched(hidden: Model, seed: int) -> tuple[Evidence, Found]:
    seen = evidence_of([recorded(hidden, seed, slots=1500)], MODEL, block="loop")
    band = nuisances(0.05, NOMINAL.backlash_gap_rad)
    return seen, seek(seen, MODEL, band, iterations=3)


def twist(seen: Evidence, found: Found) -> float:
    rows = [name.startswith("twist") for name in seen.names]
    return float(misfit(seen, found.errors)[np.array(rows)].max())


@pytest.mark.long
def test_a_load_that_coasts_is_found_to_do_so() -> None:
    seen, found = searched(coasting(MODEL, SLOWED_RAD_S2), 31)
    assert twist(seen, found) > 1.0
    better = with_coasting(seen, found)
    assert twist(seen, better) < 0.5
    assert is_coasting(better.model)
    assert slowing_rad_s2(better.model) == pytest.approx(SLOWED_RAD_S2, rel=0.2)
    assert coasting_or_rested(seen, better, found) is better
    assert coasting_or_rested(seen, found, better) is better, "the twist is right in it"
    worse = better._replace(errors=found.errors)
    assert coasting_or_rested(seen, worse, found) is found


@pytest.mark.long
def test_a_load_that_coasts_is_found_to_do_so_by_its_own_encoder_alone() -> None:
    """Else what it does in its gap is called friction of the load."""
    run = recorded(coasting(MODEL, SLOWED_RAD_S2), 31, slots=1500)
    hidden = ("motor_position_rad", "motor_torque_nm")
    alone = replace(run, channels={n: v for n, v in run.channels.items() if n not in hidden})
    seen = evidence_of([alone], MODEL, block="loop")
    found = seek(seen, MODEL, nuisances(0.05, NOMINAL.backlash_gap_rad), iterations=3)
    better = with_coasting(seen, found)
    assert is_coasting(better.model)
    assert slowing_rad_s2(better.model) == pytest.approx(SLOWED_RAD_S2, rel=0.3)


@pytest.mark.nightly
def test_what_was_fitted_to_a_load_that_stands_is_not_all_that_a_search_begins_with(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its gap and its friction stand in for what the load does."""
    rig = coasting(MODEL.with_effect("coulomb", torque_nm=6e-4), SLOWED_RAD_S2, TAKES_BOTH)
    seen = evidence_of(
        [recorded(rig, 34, slots=1500, channels=("load_angle_rad",))], MODEL, block="loop"
    )
    found = seek(seen, MODEL, nuisances(0.05, NOMINAL.backlash_gap_rad), iterations=3)
    begun_anew = with_coasting(seen, found)
    monkeypatch.setattr(coasts, "usual", lambda found: found.model)
    gone_on = with_coasting(seen, found)
    ends = (begun_anew, gone_on)
    costs = [end.errors.cost(found.sigma) for end in ends]
    wrong_rad = [abs(end.model.effects["backlash_width"].change_rad) for end in ends]
    assert costs[0] < 0.95 * costs[1]
    assert wrong_rad[0] < 0.8 * wrong_rad[1]


def test_usual_is_the_middle_of_every_band_and_what_a_cause_has_stays() -> None:
    model = MODEL.with_effect("coulomb", torque_nm=9e-4).with_effect("cogging", torque_nm=2e-3)
    band = nuisances(0.05, NOMINAL.backlash_gap_rad)
    own = widened("cogging", ("torque_nm",), model, 1e-3)
    found: Any = SimpleNamespace(model=model, unknowns=(*band, *own))
    back = usual(found)
    assert all(u.of(back) == pytest.approx(u.centre) for u in band)
    assert back.effects["cogging"] == model.effects["cogging"]


@pytest.mark.nightly
def test_what_coasts_takes_no_cause_from_a_torque_constant_by_the_loads_encoder_alone() -> None:
    """Friction of the load, with a mass that is fitted to it, takes most of what the gap does."""
    rig = MODEL.with_effect("torque_constant_error", error_fraction=0.04)
    run = recorded(
        coasting(rig, SLOWED_RAD_S2, Face(3e-5, 0.0)), 35, slots=2600, channels=("load_angle_rad",)
    )
    found = find_causes([run], MODEL)
    assert found.rounds[0].contenders[0].effect == "load_friction"
    assert {n.effect for n in found.named} <= class_of("torque_constant_error")
    assert found.named
    assert is_coasting(found.final.model)


@pytest.mark.long
@pytest.mark.parametrize("hidden", [MODEL, MODEL.with_effect("inertia_error", error_fraction=0.2)])
def test_nothing_coasts_where_the_twist_is_right_or_more_than_the_twist_is_wrong(
    hidden: Model,
) -> None:
    seen, found = searched(hidden, 32)
    assert with_coasting(seen, found) is found


@pytest.mark.long
def test_a_gap_that_is_wrong_is_found_beside_a_load_that_coasts_and_bounces() -> None:
    """How far it goes on shows only in the right gap; rigid play finds neither."""
    change_rad = 0.12 * NOMINAL.backlash_gap_rad
    wider = MODEL.with_effect("backlash_width", change_rad=change_rad)
    hidden = coasting(wider, 760.0, Face(1.5e-5, 0.0))
    found = find_causes([recorded(hidden, 51, slots=900)], MODEL, only=("backlash_width",))
    assert [n.effect for n in found.named] == ["backlash_width"]
    assert is_coasting(found.final.model)
    change = found.final.model.effects["backlash_width"].change_rad
    assert change == pytest.approx(change_rad, rel=0.03)


def test_friction_of_a_load_that_coasts_is_taken_off_the_motors() -> None:
    """While both turn together nobody tells them apart."""
    rig = MODEL.with_effect("coulomb", torque_nm=5e-3)
    effects = coasting(rig, SLOWED_RAD_S2).effects
    both = effects["coulomb"].torque_nm + effects["load_friction"].torque_nm
    assert both == pytest.approx(5e-3)
    assert effects["load_friction"].torque_nm > 0.0


@pytest.mark.long
@pytest.mark.parametrize("slope_s_per_rad", [pytest.param(0.1, marks=pytest.mark.long), 0.4])
def test_a_face_that_takes_more_of_a_fast_blow_is_found(slope_s_per_rad: float) -> None:
    """Slow blows and fast ones, which no spring and damper gives back alike."""
    hidden = coasting(MODEL, 800.0, Face(5e-6, slope_s_per_rad))
    better = with_coasting(*searched(hidden, 36))
    assert is_coasting(better.model)
    for speed_rad_s in (0.5, 3.0):
        there = given_back(hidden, speed_rad_s)
        assert given_back(better.model, speed_rad_s) == pytest.approx(there, abs=0.06)


@pytest.mark.parametrize(
    "face_s", [pytest.param(1e-6, marks=pytest.mark.nightly), 2e-5, 1.2e-4, 1e-3]
)
def test_what_a_face_gives_back_of_a_blow(face_s: float) -> None:
    """A mass on a spring and damper, until the force is used up."""
    model = coasting(MODEL, SLOWED_RAD_S2, Face(face_s, 0.0))
    contact = model.effects["contact"]
    stiffness, mass = 1.0 / contact.compliance_rad_per_nm, contact.load_inertia_kg_m2

    def force(t: float, y: tuple[float, float]) -> float:
        return float(stiffness * (y[0] + face_s * y[1]))

    def motion(t: float, y: tuple[float, float]) -> tuple[float, float]:
        return y[1], -force(t, y) / mass

    done = solve_ivp(motion, (0.0, 0.1), (0.0, 1.0), "Radau", events=force, rtol=1e-8, atol=1e-12)
    _, leaves = done.y_events[0][0]
    assert given_back(model, 1.0) == pytest.approx(-leaves, abs=1e-4)


class Costs(NamedTuple):
    """Errors that cost so much."""

    total: float

    def cost(self, _: Any) -> float:
        return self.total


def ended(model: Model, cost: float) -> Any:
    return SimpleNamespace(model=model, errors=Costs(cost), sigma=None)


@pytest.mark.parametrize(
    ("alone", "named", "coasts_at", "told"),
    [
        (True, "load_friction", 90.0, True),  # nothing but a load that coasts
        (True, "load_friction", 110.0, False),
        (True, "cogging", 90.0, False),  # which gives the load no motion of its own
        (False, "load_friction", 90.0, False),  # the motor tells of it
    ],
)
def test_friction_of_the_load_fits_better_than_one_that_coasts(
    monkeypatch: pytest.MonkeyPatch, alone: bool, named: str, coasts_at: float, told: bool
) -> None:
    coasts, final = ended(coasting(MODEL, SLOWED_RAD_S2), coasts_at), ended(MODEL, 100.0)
    monkeypatch.setattr(finding, "asked_again", lambda *_: None)
    monkeypatch.setattr(finding, "with_coasting", lambda *_, **__: coasts)
    late: Any = SimpleNamespace(whole=SimpleNamespace(is_of_the_load_alone=alone), quick=None)
    noted: Any = [SimpleNamespace(effect=named)]
    joint = finding._beside_coasting(late, late.whole, (final, final), noted, [])
    assert joint == ((coasts, []) if told else None)
