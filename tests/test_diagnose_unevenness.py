"""A loop whose integrator is held yields to every torque: so much more may its simulation miss."""

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import Evidence, evidence_of
from servo_bench.diagnosis.comparing.unevenness import SHARE, unevenness
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, recorded

MODEL = Model(NOMINAL)
HELD = MODEL.with_effect("integrator_clamp", clamp_per_a=1e3)
TORQUE_NM = 0.05


@pytest.fixture(scope="module")
def seen() -> Evidence:
    return evidence_of([recorded(MODEL, 5, slots=900)], MODEL, block="loop")


def moved(seen: Evidence, model: Model) -> dict[str, float]:
    return dict(zip(seen.names, unevenness(seen, model, TORQUE_NM), strict=True))


def test_without_its_integrator_a_loop_yields_by_torque_over_its_gains(seen: Evidence) -> None:
    """A slow torque T shifts the speed by T/(K_T K_P). Over whole turns a sine's |sin| has the
    median 1/sqrt(2), on a part of one at its worst phase up to 1; a robust deviation is 1.4826
    medians."""
    stiffness = NOMINAL.torque_constant_nm_per_a * NOMINAL.proportional_gain_a_s_per_rad
    most_rad_s = 1.4826 * SHARE * TORQUE_NM / stiffness
    found_rad_s = moved(seen, HELD)["motor velocity over 48 ms"]
    assert 0.9 / np.sqrt(2.0) < found_rad_s / most_rad_s < 1.05


def test_with_its_integrator_it_hardly_does(seen: Evidence) -> None:
    free = unevenness(seen, MODEL, TORQUE_NM) / seen.allowed
    assert float(free.max()) < 0.3
    assert (
        moved(seen, HELD)["motor velocity over 288 ms"]
        > 5.0 * (moved(seen, MODEL)["motor velocity over 288 ms"])
    )


def test_cogging_of_its_own_is_known(seen: Evidence) -> None:
    uneven = HELD.with_effect("cogging", torque_nm=1e-3, order=12.0)
    np.testing.assert_array_equal(unevenness(seen, uneven, TORQUE_NM), 0.0)
