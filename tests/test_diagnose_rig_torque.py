"""What friction and magnets have of their own is the motor's, whatever an excitation asks of it."""

import numpy as np
import pytest

from servo_bench.diagnosis.searching.scales import LIGHTEST, Scales, scales_of
from servo_bench.diagnosis.searching.unknowns import nuisances
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, nominal_with

PERIOD_S = 0.008


def scales(model: Model, most_rad_s: float, seed: int = 3) -> Scales:
    commands = np.random.default_rng(seed).uniform(-most_rad_s, most_rad_s, 400)
    return scales_of(model, commands, PERIOD_S)


def test_a_harsh_excitation_has_the_bands_of_a_gentle_one() -> None:
    gentle, harsh = (scales(Model(NOMINAL), most_rad_s) for most_rad_s in (1.0, 10.0))
    assert harsh.torque_nm > 5.0 * gentle.torque_nm
    assert harsh.rig_torque_nm == gentle.rig_torque_nm
    bands = [nuisances(s.rig_torque_nm, s.gap_rad) for s in (gentle, harsh)]
    assert bands[0] == bands[1]


def test_torque_goes_with_inertia_as_in_a_family_of_motors() -> None:
    """Torque as the cube of a size, inertia as its fifth power: a size of twice has 8 of 32."""
    one, larger = (scales(Model(nominal_with(inertia_kg_m2=k)), 3.0) for k in (1.0, 32.0))
    assert larger.rig_torque_nm / one.rig_torque_nm == pytest.approx(8.0)


def test_a_coupling_and_its_bearings_do_not_shrink_with_the_lightest_motor() -> None:
    light, lighter = (scales(Model(nominal_with(inertia_kg_m2=k)), 3.0) for k in (0.1, 0.02))
    usual = scales(Model(NOMINAL), 3.0)
    assert 0.1 * usual.inertia_kg_m2 / 2.5e-4 < LIGHTEST
    assert light.rig_torque_nm == lighter.rig_torque_nm
