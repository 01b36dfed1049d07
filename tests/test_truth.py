"""The small truth plant obeys physics, and the second hand is nobody's copy."""

import ast
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import curve_fit

from sim_rig.plant import Plant, PlantOutputs
from tests import truth
from tests.truth.toy_plant import ToyPlant, ToyTruth, hidden, make

GAP_RAD = math.radians(1.5)
VELOCITY_RAD_S = math.radians(150.0)
PERIOD_S = 0.008


@dataclass(frozen=True)
class Nominal:
    """The paper's motor, gap and wn dt = 0.5, zeta = 0.4 at 8 ms."""

    torque_constant_nm_per_a: float = 0.03606
    inertia_kg_m2: float = 0.00025
    proportional_gain_a_s_per_rad: float = 0.3466444814
    integral_gain_a_per_rad: float = 27.0816001109
    backlash_gap_rad: float = GAP_RAD


NOMINAL = Nominal()
TRUTH = ToyTruth()


def played(plant: Plant, commands: Iterable[float], period_s: float) -> list[PlantOutputs]:
    """The outputs at each command's start."""
    outputs = []
    for command_rad_s in commands:
        outputs.append(plant.outputs())
        plant.advance(command_rad_s, period_s)
    return outputs


def random_commands(chips: int) -> list[float]:
    """Signs at random, at the paper's speed."""
    bits = np.random.default_rng(0).integers(0, 2, chips)
    return [VELOCITY_RAD_S * (1 - 2 * int(bit)) for bit in bits]


def twist_rad(outputs: PlantOutputs) -> float:
    """How far the motor is ahead of the load."""
    return outputs.motor_position_rad - outputs.load_angle_rad


def load_rad(outputs: Iterable[PlantOutputs]) -> NDArray[np.float64]:
    """The load angle, shape (n,)."""
    return np.array([o.load_angle_rad for o in outputs])


def windup_rad() -> float:
    """What Hertz's contact gives way under the shaft's friction: k p^1.5 = T_l."""
    ratio = TRUTH.load_friction_nm / TRUTH.contact_stiffness_nm_per_rad15
    return math.pow(ratio, 2.0 / 3.0)


# --- physics ---------------------------------------------------------------------------------


@pytest.mark.parametrize("reversed_for_s", [0.012, 0.016, 0.020, 0.024, 0.028])
def test_coasting_never_gains_energy(reversed_for_s: float) -> None:
    plant = ToyPlant(NOMINAL, 1, TRUTH)
    plant.advance(5.0, 0.3)
    plant.advance(-5.0, reversed_for_s)
    plant.advance(None, 20 * TRUTH.current_lag_s)
    energies_j = []
    for _ in range(1600):
        energies_j.append(plant.energy_j())
        plant.advance(None, TRUTH.step_s)
    assert np.diff(energies_j).max() <= 1e-9 * energies_j[0]
    assert energies_j[-1] < energies_j[0]


def test_coasting_ends_at_rest() -> None:
    plant = make(NOMINAL, 1)
    plant.advance(1.0, 0.5)
    plant.advance(None, 2.0)
    before = plant.outputs()
    plant.advance(None, 0.1)
    assert plant.outputs() == before
    assert before.motor_velocity_rad_s == 0.0


def test_coulomb_friction_slows_both_inertias_evenly() -> None:
    plant = hidden(motor_viscous_nm_s_per_rad=0.0)(NOMINAL, 1)
    plant.advance(3.0, 0.5)
    plant.advance(None, 0.01)
    before = plant.outputs()
    plant.advance(None, 0.5)
    friction_nm = TRUTH.motor_friction_nm + TRUTH.load_friction_nm
    lost_rad_s = before.motor_velocity_rad_s - plant.outputs().motor_velocity_rad_s
    assert lost_rad_s == pytest.approx(0.5 * friction_nm / NOMINAL.inertia_kg_m2, rel=1e-3)


def test_viscous_friction_slows_exponentially() -> None:
    drag = 2e-4
    plant = hidden(motor_viscous_nm_s_per_rad=drag, motor_friction_nm=0.0, load_friction_nm=0.0)(
        NOMINAL, 1
    )
    plant.advance(3.0, 0.5)
    plant.advance(None, 0.01)
    before = plant.outputs()
    plant.advance(None, 1.0)
    left = plant.outputs().motor_velocity_rad_s / before.motor_velocity_rad_s
    assert left == pytest.approx(math.exp(-drag / NOMINAL.inertia_kg_m2), rel=2e-3)


def test_the_current_lags_and_its_torque_with_it() -> None:
    ideal = hidden(motor_viscous_nm_s_per_rad=0.0, motor_friction_nm=0.0, torque_noise_nm=0.0)
    plant = ideal(NOMINAL, 1)
    plant.advance(1.0, TRUTH.loop_period_s)
    outputs = plant.outputs()
    gain = NOMINAL.proportional_gain_a_s_per_rad
    reference_a = gain + NOMINAL.integral_gain_a_per_rad * TRUTH.loop_period_s
    risen = 1.0 - math.exp(-TRUTH.loop_period_s / TRUTH.current_lag_s)
    assert outputs.motor_current_a == pytest.approx(risen * reference_a, rel=1e-9)
    charge_as = reference_a * (TRUTH.loop_period_s - TRUTH.current_lag_s * risen)
    rotor_kg_m2 = NOMINAL.inertia_kg_m2 - TRUTH.load_inertia_kg_m2
    assert outputs.motor_velocity_rad_s == pytest.approx(
        NOMINAL.torque_constant_nm_per_a * charge_as / rotor_kg_m2, rel=1e-9
    )


def test_the_loop_sees_whole_counts_only() -> None:
    """Within the first count of a coarse encoder the loop is blind: i = K_P r + K_I r t."""
    plant = hidden(motor_counts_per_revolution=16)(NOMINAL, 1)
    plant.advance(1.0, 0.01)
    assert 0.0 < plant.outputs().motor_position_rad < math.tau / 16
    blind_a = NOMINAL.proportional_gain_a_s_per_rad + 0.01 * NOMINAL.integral_gain_a_per_rad
    assert plant.outputs().motor_current_a == pytest.approx(blind_a, rel=0.01)


def test_the_contact_never_pulls() -> None:
    friction_nm = 0.03e-3
    factory = hidden(load_friction_nm=friction_nm, contact_damping_s_per_rad=1000.0)
    plant = factory(NOMINAL, 1)
    plant.advance(VELOCITY_RAD_S, 0.5)
    # The motor falls back faster than friction slows the load: the sticky contact opens.
    angle_rad = load_rad(played(plant, [-VELOCITY_RAD_S] * 100, TRUTH.step_s))
    acceleration = np.diff(angle_rad, 2) / TRUTH.step_s**2
    assert acceleration.min() >= -1.01 * friction_nm / TRUTH.load_inertia_kg_m2


def test_the_coupling_never_opens_beyond_gap_and_impact_windup() -> None:
    outputs = played(make(NOMINAL, 1), random_commands(1000), PERIOD_S)
    fastest_rad_s = max(abs(o.motor_velocity_rad_s) for o in outputs)
    twists_rad = [twist_rad(o) for o in outputs]
    # An impact stores at most the shaft's energy at the closing speed: (2/5) k p^2.5 = J_l v^2 / 2.
    # Shaft and rotor each move at most this fast, against each other.
    closing_rad_s = 2.0 * fastest_rad_s
    stored = 1.25 * TRUTH.load_inertia_kg_m2 * closing_rad_s**2
    windup = math.pow(stored / TRUTH.contact_stiffness_nm_per_rad15, 0.4)
    assert max(abs(t) for t in twists_rad) < GAP_RAD / 2 + windup
    assert max(twists_rad) > GAP_RAD / 2
    assert min(twists_rad) < -GAP_RAD / 2


@pytest.mark.parametrize("velocity_rad_s", [2.0, -2.0])
def test_a_constant_command_is_reached_with_the_load_on_the_driving_flank(
    velocity_rad_s: float,
) -> None:
    plant = make(NOMINAL, 1)
    plant.advance(velocity_rad_s, 1.0)
    start = plant.outputs()
    plant.advance(velocity_rad_s, 1.0)
    end = plant.outputs()
    assert end.motor_position_rad - start.motor_position_rad == pytest.approx(
        velocity_rad_s, rel=1e-4
    )
    assert end.load_angle_rad - start.load_angle_rad == pytest.approx(velocity_rad_s, rel=1e-4)
    pressed_rad = math.copysign(1.0, velocity_rad_s) * twist_rad(end) - GAP_RAD / 2
    assert pressed_rad == pytest.approx(windup_rad(), rel=0.1)


def test_reversing_leaves_the_load_behind_until_the_gap_is_crossed() -> None:
    plant = make(NOMINAL, 1)
    plant.advance(0.2, 1.0)
    outputs = played(plant, [-0.2] * 600, 0.5e-3)
    rests = np.flatnonzero(np.diff(load_rad(outputs)) == 0.0)
    first, last = outputs[int(rests[0])], outputs[int(rests[-1]) + 1]
    assert np.array_equal(rests, np.arange(rests[0], rests[-1] + 1))
    crossed_rad = first.motor_position_rad - last.motor_position_rad
    assert crossed_rad == pytest.approx(GAP_RAD, rel=0.02)


@pytest.mark.parametrize("gap_rad", [0.5 * GAP_RAD, 1.3 * GAP_RAD])
def test_a_slow_reversal_shows_the_gap(gap_rad: float) -> None:
    plant = hidden(backlash_gap_rad=gap_rad)(NOMINAL, 3)
    plant.advance(0.2, 1.0)
    ahead_rad = twist_rad(plant.outputs())
    plant.advance(-0.2, 1.0)
    behind_rad = twist_rad(plant.outputs())
    assert ahead_rad - behind_rad == pytest.approx(gap_rad + 2 * windup_rad(), rel=0.005)


def test_a_step_answers_as_the_loop_is_tuned() -> None:
    outputs = played(make(NOMINAL, 1), [10.0] * 300, 0.5e-3)
    velocity_rad_s = np.array([o.motor_velocity_rad_s for o in outputs])
    time_s = 0.5e-3 * np.arange(velocity_rad_s.size)

    def second_order(
        t: NDArray[np.float64], wn: float, zeta: float
    ) -> NDArray[np.float64]:  # (2 zeta wn s + wn^2) / (s^2 + 2 zeta wn s + wn^2) of a step
        sigma, wd = zeta * wn, wn * math.sqrt(1.0 - zeta**2)
        wave = np.cos(wd * t) - sigma / wd * np.sin(wd * t)
        return np.asarray(10.0 * (1.0 - np.exp(-sigma * t) * wave), dtype=np.float64)

    (wn, zeta), _ = curve_fit(second_order, time_s, velocity_rad_s, p0=(50.0, 0.5))
    stiffness = NOMINAL.torque_constant_nm_per_a / NOMINAL.inertia_kg_m2
    expected_wn = math.sqrt(NOMINAL.integral_gain_a_per_rad * stiffness)
    expected_zeta = NOMINAL.proportional_gain_a_s_per_rad * stiffness / (2.0 * expected_wn)
    assert wn == pytest.approx(expected_wn, rel=0.03)
    assert zeta == pytest.approx(expected_zeta, rel=0.05)


def test_friction_holds_a_resting_axis() -> None:
    plant = hidden(torque_noise_nm=0.0)(NOMINAL, 1)
    before = plant.outputs()
    plant.advance(0.0, 0.5)
    assert plant.outputs() == before


# --- numerics --------------------------------------------------------------------------------


def test_halving_the_step_hardly_moves_the_load() -> None:
    commands = random_commands(500)
    coarse = load_rad(played(make(NOMINAL, 1), commands, PERIOD_S))
    halved = hidden(substeps=2 * TRUTH.substeps)(NOMINAL, 1)
    fine = load_rad(played(halved, commands, PERIOD_S))
    difference_rad = coarse - fine
    assert np.abs(difference_rad).max() < 1e-4
    assert np.sqrt(np.mean(difference_rad**2)) < 1e-5


def test_how_time_is_cut_does_not_matter() -> None:
    whole, cut = make(NOMINAL, 1), make(NOMINAL, 1)
    for command_rad_s in random_commands(20):
        whole.advance(command_rad_s, PERIOD_S)
        for part in (0.1, 0.37, 0.33, 0.2):
            cut.advance(command_rad_s, part * PERIOD_S)
    assert cut.outputs().load_angle_rad == pytest.approx(whole.outputs().load_angle_rad, abs=1e-12)


def test_outputs_between_steps_go_on_with_the_motion() -> None:
    plant = make(NOMINAL, 1)
    plant.advance(2.0, 0.5)
    before = plant.outputs()
    plant.advance(2.0, 0.4 * TRUTH.step_s)
    moved_rad = plant.outputs().load_angle_rad - before.load_angle_rad
    assert moved_rad == pytest.approx(2.0 * 0.4 * TRUTH.step_s, rel=0.05)


def test_outputs_change_nothing() -> None:
    asked, left = make(NOMINAL, 1), make(NOMINAL, 1)
    for command_rad_s in random_commands(20):
        asked.outputs()
        asked.advance(command_rad_s, PERIOD_S)
        left.advance(command_rad_s, PERIOD_S)
    assert asked.outputs() == left.outputs()


def test_the_seed_decides() -> None:
    commands = random_commands(100)
    first, again, other = (
        load_rad(played(make(NOMINAL, seed), commands, PERIOD_S)) for seed in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert first[0] != other[0]


@pytest.mark.parametrize(("noise_nm", "same"), [(0.2e-3, False), (0.0, True)])
def test_without_a_gap_the_seed_is_in_the_torque_alone(noise_nm: float, same: bool) -> None:
    factory = hidden(backlash_gap_rad=0.0, torque_noise_nm=noise_nm)
    one, two = (
        load_rad(played(factory(NOMINAL, s), random_commands(50), PERIOD_S)) for s in (1, 2)
    )
    assert np.array_equal(one, two) == same


# --- independence ----------------------------------------------------------------------------

TRUTH_FILES = sorted(Path(truth.__file__).parent.rglob("*.py"))

ALLOWED = {
    "__future__",
    "collections.abc",
    "dataclasses",
    "math",
    "numpy",
    "numpy.typing",
    "typing",
}
ALLOWED |= {"sim_rig.plant"}

ALLOWED_TO = {
    "compiling.py": {"hashlib", "pathlib", "numba"},
    "stepping.py": {"pathlib"},
    "catalogue.py": {"types"},
    "hidden.py": {"servo_bench.excitation.experiment", "servo_bench.recording.recording"},
}


def imported(source: str) -> Iterator[str]:
    """Every module that a source imports, by whichever statement; `__import__` as itself."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield "." * node.level + (node.module or "")
        elif isinstance(node, ast.Name) and node.id in ("__import__", "exec", "eval"):
            yield node.id


def strangers(source: str, allowed: set[str]) -> list[str]:
    """The imports that the second hand may not make."""
    return [
        name
        for name in imported(source)
        if name not in allowed and name != "tests.truth" and not name.startswith("tests.truth.")
    ]


@pytest.mark.parametrize("path", TRUTH_FILES, ids=lambda path: path.name)
def test_the_truth_imports_no_equation_of_the_model(path: Path) -> None:
    allowed = ALLOWED | ALLOWED_TO.get(path.name, set())
    assert strangers(path.read_text(encoding="utf-8"), allowed) == []


@pytest.mark.parametrize(
    "source",
    [
        "import sim_rig.model",
        "from sim_rig import settings",
        "from sim_rig.settings import Nominal",
        "def f():\n    import servo_bench.rig",
        "from ..other import thing",
        "import importlib",
        "__import__('sim_rig.model')",
    ],
)
def test_a_stranger_is_seen(source: str) -> None:
    assert strangers(source, ALLOWED)


def test_the_truth_was_looked_at() -> None:
    assert {path.name for path in TRUTH_FILES} >= {"hidden.py", "toy_plant.py", "plant.py"}
