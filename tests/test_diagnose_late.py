"""What no round named, asked once more beside a load that coasts."""

from collections.abc import Sequence

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import evidence_of
from servo_bench.diagnosis.searching.coasting import coasting, is_coasting
from servo_bench.diagnosis.searching.finding import find_causes, nothing_told
from servo_bench.diagnosis.searching.hypotheses import hypotheses
from servo_bench.diagnosis.searching.joint import Named
from servo_bench.diagnosis.searching.late import Late, asked_again, asked_late
from servo_bench.diagnosis.searching.scales import band_of, scales_of
from servo_bench.diagnosis.searching.seeking import Found, seek
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, recorded

MODEL = Model(NOMINAL)
SLOWED_RAD_S2 = 350.0
COUPLING, COMPLIANCE_RAD_PER_NM, HUB_KG_M2 = "coupling_compliance", 4e-3, 7.5e-5
SOFT = MODEL.with_effect(
    COUPLING,
    compliance_rad_per_nm=COMPLIANCE_RAD_PER_NM,
    load_inertia_kg_m2=HUB_KG_M2,
    damping_s=4e-5,
)


def lately(hidden: Model, seed: int, only: Sequence[str], slots: int = 800) -> tuple[Late, Found]:
    """Everything that was recorded, and the fit without a cause."""
    run = recorded(hidden, seed, slots=slots)
    seen = evidence_of([run], MODEL, block="loop")
    commands = np.asarray(run["velocity_command_rad_s"])
    scales = scales_of(MODEL, commands, PERIOD_S)
    band = band_of(scales, MODEL)
    plain = seek(seen, MODEL, band, iterations=3)
    tried = hypotheses(scales, motor_orders=(24.0,), only=only)
    return Late(seen, seen, tried, scales, band, nothing_told), plain


def again(
    hidden: Model, seed: int, *only: str, slots: int = 800
) -> tuple[Found, list[Named]] | None:
    late, plain = lately(hidden, seed, only or (COUPLING,), slots)
    return asked_again(late, late.whole, plain, plain, lambda _: None)


@pytest.mark.nightly
def test_a_coupling_is_found_where_the_load_coasts_beside_it() -> None:
    found = again(coasting(SOFT, SLOWED_RAD_S2), 61, slots=1600)
    assert found is not None
    final, named = found
    assert [n.effect for n in named] == [COUPLING]
    assert is_coasting(final.model)
    found_rad_per_nm = final.model.effects[COUPLING].compliance_rad_per_nm
    assert found_rad_per_nm == pytest.approx(COMPLIANCE_RAD_PER_NM, rel=0.15)


@pytest.mark.nightly
def test_a_coupling_that_hides_behind_a_load_that_coasts_is_named() -> None:
    run = recorded(coasting(SOFT, SLOWED_RAD_S2), 65, slots=1200)
    found = find_causes([run], MODEL, only=(COUPLING,))
    assert [n.effect for n in found.named] == [COUPLING]
    assert is_coasting(found.final.model)
    assert found.absorbed == ()


@pytest.mark.long
@pytest.mark.parametrize("only", [("thermal_friction",), ("thermal_friction", "coulomb")])
def test_constant_friction_is_not_called_one_that_warms(only: tuple[str, ...]) -> None:
    """In seven seconds of ten minutes they are alike: the plain one is asked beside it, and nothing
    that the rounds had asked is named here."""
    late, plain = lately(MODEL.with_effect("coulomb", torque_nm=6e-3), 66, only)
    found = asked_late(late, plain, (), frozenset())
    assert (found is None) == ("coulomb" in only)


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "slowed_rad_s2"),
    [(62, 350.0), pytest.param(*(63, 1200.0), marks=pytest.mark.long)],
)
def test_none_is_found_where_there_is_none(seed: int, slowed_rad_s2: float) -> None:
    assert again(coasting(MODEL, slowed_rad_s2), seed) is None


@pytest.mark.long
def test_where_nothing_coasts_nothing_is_asked() -> None:
    assert again(SOFT, 64) is None


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("line_nm", "causes"),
    [(2.4e-4, ["inverter_dead_time"]), (8e-4, ["cogging", "inverter_dead_time"])],
)
def test_a_dead_time_shows_beside_a_load_that_coasts_and_a_line(
    line_nm: float, causes: list[str]
) -> None:
    """The line comes first: too small for a name it is part of the base from then on, and of a
    cause's size it is one, beside which the other is asked."""
    rippled = MODEL.with_effect("cogging", torque_nm=line_nm, order=24.0)
    late = rippled.with_effect("inverter_dead_time", notch_a=0.05, pole_pair_count=4.0)
    found = again(coasting(late, SLOWED_RAD_S2), 67, "cogging", "inverter_dead_time")
    assert found is not None
    final, named = found
    assert [n.effect for n in named] == causes
    assert final.value("inverter_dead_time.notch_a") == pytest.approx(0.05, rel=0.2)
    assert final.value("cogging.torque_nm") == pytest.approx(line_nm, rel=0.2)
