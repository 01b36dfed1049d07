"""A loop that cannot answer a torque yields to it: so much more may its simulation miss."""

from dataclasses import replace

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import Evidence, changed_by, evidence_of
from servo_bench.diagnosis.comparing.unevenness import MOST, lines, unevenness
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, recorded

MODEL = Model(NOMINAL)
HELD = MODEL.with_effect("integrator_clamp", clamp_per_a=1e3)
SOFT = Model(
    replace(
        NOMINAL,
        proportional_gain_a_s_per_rad=0.3 * NOMINAL.proportional_gain_a_s_per_rad,
        integral_gain_a_per_rad=0.1 * NOMINAL.integral_gain_a_per_rad,
    )
)
TORQUE_NM = 0.036
SLOW = "motor velocity over 288 ms"


def seen_on(model: Model) -> Evidence:
    return evidence_of([recorded(model, 5, slots=900)], model, block="loop")


@pytest.fixture(scope="module")
def seen() -> Evidence:
    return seen_on(MODEL)


def moved(seen: Evidence, model: Model, name: str = SLOW) -> float:
    return float(unevenness(seen, model, TORQUE_NM)[seen.names.index(name)])


def test_a_model_that_runs_away_tells_nothing(seen: Evidence) -> None:
    """Its errors are infinite, and what another changes in them is no number."""
    stiff = replace(NOMINAL, proportional_gain_a_s_per_rad=1e3)
    away = Model(stiff).with_effect("velocity_filter_lag", lag_s=5e-3)
    away = away.with_effect("current_loop_lag", lag_s=2e-3)
    assert seen.seen([away])[0].ran_away
    np.testing.assert_array_equal(changed_by(seen, away, [MODEL, away]), 0.0)


def test_without_its_integrator_a_loop_yields_by_torque_over_its_gains(seen: Evidence) -> None:
    """A slow torque T shifts the speed by T/(K_T K_P). Over whole turns a sine's |sin| has the
    median 1/sqrt(2), on a part of one at its worst phase up to 1; a robust deviation is 1.4826
    medians."""
    torque_nm = 2e-4
    stiffness = NOMINAL.torque_constant_nm_per_a * NOMINAL.proportional_gain_a_s_per_rad
    most_rad_s = 1.4826 * torque_nm / stiffness
    found = changed_by(seen, HELD, lines(HELD, torque_nm, 1.0))
    found_rad_s = float(found[seen.names.index("motor velocity over 48 ms")])
    assert 0.9 / np.sqrt(2.0) < found_rad_s / most_rad_s < 1.05
    assert moved(seen, HELD) > 0.0


def test_a_stiff_loop_with_its_integrator_may_miss_no_more_than_ever(seen: Evidence) -> None:
    np.testing.assert_array_equal(unevenness(seen, MODEL, TORQUE_NM), 0.0)


def test_a_soft_loop_yields_with_its_integrator_too() -> None:
    """By no more than what would tell nothing any more."""
    soft = seen_on(SOFT)
    share = unevenness(soft, SOFT, TORQUE_NM) / soft.allowed
    assert 0.5 < float(share[soft.names.index("motor velocity over 48 ms")]) < MOST


@pytest.mark.parametrize("order", [1.0, 6.0, 24.0])
def test_of_a_line_of_its_own_it_may_miss_no_more(seen: Evidence, order: float) -> None:
    """Each of four torques adds its square; of one that the model has, none is asked."""
    own = HELD.with_effect("cogging", torque_nm=1e-4, order=order)
    another = HELD.with_effect("cogging", torque_nm=1e-4, order=13.0)
    quick = "motor velocity over 48 ms"  # what is slower is at its bound
    assert 0.0 < moved(seen, own, quick) < moved(seen, another, quick)


def test_lines_are_beside_those_that_a_model_has() -> None:
    own = MODEL.with_effect("cogging", torque_nm=1e-3, order=12.0, second_torque_nm=2e-3)
    for model in lines(own, 3e-4, 6.0):
        params = model.effects["cogging"]
        assert (params.torque_nm, params.second_torque_nm, params.third_torque_nm) == (
            pytest.approx(1e-3),
            pytest.approx(2e-3),
            pytest.approx(3e-4),
        )
        assert params.third_order == 6.0


def test_a_third_line_of_its_own_lets_it_miss_no_more(seen: Evidence) -> None:
    """There is no place for a fourth: what one would change is asked beside the first two."""
    two = MODEL.with_effect(
        "cogging", torque_nm=6e-3, order=12.0, second_torque_nm=4e-3, second_order=8.0
    )
    kept = two.effects["cogging"]._asdict()
    three = two.with_effect("cogging", **kept | {"third_torque_nm": 4e-3, "third_order": 30.0})
    np.testing.assert_array_equal(unevenness(seen, two, TORQUE_NM), 0.0)
    np.testing.assert_array_equal(unevenness(seen, three, TORQUE_NM), 0.0)
