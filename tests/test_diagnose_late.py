"""What was too little for a name, asked once more beside a load that coasts."""

from collections.abc import Sequence

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import evidence_of
from servo_bench.diagnosis.searching.coasting import coasting, is_coasting
from servo_bench.diagnosis.searching.finding import find_causes, nothing_told
from servo_bench.diagnosis.searching.hypotheses import hypotheses
from servo_bench.diagnosis.searching.joint import Named
from servo_bench.diagnosis.searching.late import Late, asked_again, asked_late
from servo_bench.diagnosis.searching.scales import scales_of
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.unknowns import nuisances
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, recorded

MODEL = Model(NOMINAL)
SLOWED_RAD_S2 = 350.0
COUPLING, COMPLIANCE_RAD_PER_NM, HUB_KG_M2 = "coupling_compliance", 4e-3, 7.5e-5
ASKED = frozenset({COUPLING})
SOFT = MODEL.with_effect(
    COUPLING,
    compliance_rad_per_nm=COMPLIANCE_RAD_PER_NM,
    load_inertia_kg_m2=HUB_KG_M2,
    damping_s=4e-5,
)


def lately(hidden: Model, seed: int, only: Sequence[str]) -> tuple[Late, Found]:
    """Everything that was recorded, and the fit without a cause."""
    run = recorded(hidden, seed, slots=800)
    seen = evidence_of([run], MODEL, block="loop")
    commands = np.asarray(run["velocity_command_rad_s"])
    scales = scales_of(MODEL, commands, PERIOD_S)
    band = nuisances(scales.rig_torque_nm, scales.gap_rad)
    plain = seek(seen, MODEL, band, iterations=3)
    return Late(seen, seen, hypotheses(scales, only=only), scales, band, nothing_told), plain


def again(hidden: Model, seed: int, asked: frozenset[str] = ASKED) -> list[Named] | None:
    found = asked_again(*lately(hidden, seed, [COUPLING]), asked)
    return None if found is None else found[1]


@pytest.mark.long
def test_a_coupling_is_found_where_the_load_coasts_beside_it() -> None:
    found = again(coasting(SOFT, SLOWED_RAD_S2), 61)
    assert found is not None
    assert [n.effect for n in found] == [COUPLING]
    model = found[0].contender.found.model
    assert is_coasting(model)
    found_rad_per_nm = model.effects[COUPLING].compliance_rad_per_nm
    assert found_rad_per_nm == pytest.approx(COMPLIANCE_RAD_PER_NM, rel=0.15)


@pytest.mark.long
def test_a_coupling_that_hides_behind_a_load_that_coasts_is_named() -> None:
    run = recorded(coasting(SOFT, SLOWED_RAD_S2), 65, slots=1200)
    found = find_causes([run], MODEL, only=(COUPLING,))
    assert [n.effect for n in found.named] == [COUPLING]
    assert is_coasting(found.final.model)
    assert found.absorbed == ()


@pytest.mark.parametrize("only", [("thermal_friction",), ("thermal_friction", "coulomb")])
def test_constant_friction_is_not_called_one_that_warms(only: tuple[str, ...]) -> None:
    """In seven seconds of ten minutes they are alike: the plain one is asked beside it, and nothing
    that the rounds had asked is named here."""
    late, plain = lately(MODEL.with_effect("coulomb", torque_nm=6e-3), 66, only)
    found = asked_late(late, plain, (), frozenset())
    assert (found is None) == ("coulomb" in only)


@pytest.mark.parametrize(("seed", "slowed_rad_s2"), [(62, 350.0), (63, 1200.0)])
def test_none_is_found_where_there_is_none(seed: int, slowed_rad_s2: float) -> None:
    assert again(coasting(MODEL, slowed_rad_s2), seed) is None


def test_where_nothing_coasts_or_nothing_was_too_little_nothing_is_asked() -> None:
    assert again(SOFT, 64) is None
    assert again(coasting(SOFT, SLOWED_RAD_S2), 61, asked=frozenset()) is None
