"""A rig whose drive is geared and counts the other way is the same rig to the bench."""

import numpy as np
import pytest

from servo_bench.errors import BenchError
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.virtual import run_virtually
from sim_rig.errors import RigSettingsError
from sim_rig.mounted import Mounted, mounted
from sim_rig.process import plant_of
from tests.small_runs import experiment

PAPER = load_rig("rigs/paper.toml")


def turned(gear_ratio: float, motor: int, load: int) -> RigConfig:
    table = PAPER.model_dump()
    table["drive"] |= {"gear_ratio": gear_ratio, "direction": motor}
    table["encoder"] |= {"direction": load}
    return RigConfig.model_validate(table)


@pytest.mark.parametrize(
    ("gear_ratio", "motor", "load"), [(5.0, 1, 1), (1.0, -1, 1), (2.5, -1, -1)]
)
def test_a_rig_that_is_mounted_otherwise_is_the_same_to_the_bench(
    gear_ratio: float, motor: int, load: int
) -> None:
    plain = run_virtually(experiment(), PAPER)
    other = run_virtually(experiment(), turned(gear_ratio, motor, load))
    count = 2.0 * np.pi / 65536
    for name in ("motor_position_rad", "load_angle_rad"):
        np.testing.assert_allclose(other[name], plain[name], atol=2.5 * count, err_msg=name)
    for name in ("motor_torque_nm", "motor_velocity_rad_s"):
        if name in plain:
            scale = float(np.nanmax(np.abs(plain[name])))
            np.testing.assert_allclose(other[name], plain[name], atol=0.01 * scale, err_msg=name)


def test_a_plant_that_sits_straight_is_left_as_it_is() -> None:
    settings = PAPER.simulation_settings()
    plant = plant_of(settings)
    assert not isinstance(plant, Mounted)
    assert mounted(plant, settings) is plant


def test_effects_beside_a_plant_of_ones_own_are_refused() -> None:
    table = PAPER.model_dump()
    own = {"plant": "tests.truth.plant:make", "effects": {"coulomb": {"torque_nm": 0.01}}}
    table["simulated"] = own
    with pytest.raises((BenchError, RigSettingsError), match="effects are given for plant"):
        RigConfig.model_validate(table).simulation_settings()


def test_a_software_rig_has_no_filter_in_front_of_its_torque() -> None:
    table = PAPER.model_dump()
    table["drive"] |= {"torque_filter_s": 4e-3}
    simulated = RigConfig.model_validate(table).as_simulated(port=7)
    assert (simulated.drive.torque_filter_s, simulated.bus["port"]) == (0.0, 7)
