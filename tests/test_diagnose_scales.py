"""How large things are on a rig: what its controller does between the samples, and holds."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.diagnosis.comparing.rows import rows_of
from servo_bench.diagnosis.searching.readying import FEW, _largest_a
from servo_bench.diagnosis.searching.scales import scales_of
from sim_rig.model import Model
from sim_rig.settings import Nominal
from tests.fit_recordings import NOMINAL, recorded

PERIOD_S, PARTS = 0.008, 160
SOFT = Nominal(0.43485, 1.42e-3, 0.22936, 8.3512, 0.02618)
STIFF = Nominal(0.18350, 1.0e-3, 1.1292, 86.68, 0.0524)


def random_commands(seed: int, slots: int = 300) -> NDArray[np.float64]:
    """Velocities that change every tenth slot on average."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-3.0, 3.0, slots), rng.integers(1, 20, slots))[:slots]


@pytest.mark.parametrize("nominal", [SOFT, STIFF])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_integrator_holds_what_its_error_has_summed_up_to(nominal: Nominal, seed: int) -> None:
    """K_I x = K_I int (command - velocity) dt, summed here in steps of 50 microseconds."""
    commands, model = random_commands(seed), Model(nominal)
    often = np.repeat(commands, PARTS)
    velocity = model.simulate(often, PERIOD_S / PARTS).motor_velocity_rad_s
    summed = np.append(0.0, np.cumsum(often - velocity))[:-1][::PARTS] * PERIOD_S / PARTS
    wanted = np.quantile(nominal.integral_gain_a_per_rad * np.abs(summed), (0.98, 0.9, 0.75))
    np.testing.assert_allclose(scales_of(model, commands, PERIOD_S).integral_a, wanted, rtol=0.05)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_stiff_loop_asks_for_most_of_its_current_between_the_samples(seed: int) -> None:
    """Right after a jump the current is K_P times it, and J / (K_P K_T) later a third of that."""
    commands = random_commands(seed)
    loop_s = STIFF.inertia_kg_m2 / (
        STIFF.proportional_gain_a_s_per_rad * STIFF.torque_constant_nm_per_a
    )
    assert loop_s < PERIOD_S
    scales = scales_of(Model(STIFF), commands, PERIOD_S)
    largest = STIFF.proportional_gain_a_s_per_rad * float(np.abs(np.diff(commands)).max())
    assert 0.5 * largest < scales.peaks_a[0] < 1.1 * largest
    assert scales.peaks_a[0] > 2.0 * scales.currents_a[0]


@pytest.mark.parametrize("name", ["motor_torque_nm", "torque_nm", "motor_current_a", "current_a"])
def test_the_largest_current_is_known_by_whatever_tells_it(name: str) -> None:
    """As a drive names it, and as an import's map does."""
    run = recorded(Model(NOMINAL), 4)
    torque_nm = np.asarray(run["motor_torque_nm"])
    per_a = NOMINAL.torque_constant_nm_per_a if name.endswith("_nm") else 1.0
    channels = {n: v for n, v in run.channels.items() if n != "motor_torque_nm"}
    channels[name] = torque_nm / NOMINAL.torque_constant_nm_per_a * per_a
    rows = rows_of(replace(run, channels=channels))
    (largest_a,) = _largest_a(rows, Model(NOMINAL))
    largest_nm = np.sort(np.abs(torque_nm))[-FEW]
    assert largest_a == pytest.approx(largest_nm / NOMINAL.torque_constant_nm_per_a)
