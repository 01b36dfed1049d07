"""The rig's equations against other people's mathematics, and the laws they must keep."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import TransferFunction, cont2discrete, lfilter, step

from sim_rig.errors import RigSettingsError
from sim_rig.motor import doubling_steps, exact_step, step_lengths_us
from sim_rig.paper_plant import PaperPlant
from sim_rig.plant import PlantOutputs
from sim_rig.play import Limits, play
from sim_rig.settings import Nominal
from sim_rig.simulation import simulate
from tests.wire import NOMINAL

PAPER_SIMULATION = Nominal(
    torque_constant_nm_per_a=0.03606,
    inertia_kg_m2=0.00025,
    proportional_gain_a_s_per_rad=0.8 * 0.00025 / 0.03606,
    integral_gain_a_per_rad=0.00025 / 0.03606,
    backlash_gap_rad=0.8,
)
"""The paper's simulated rig: zeta = 0.4, wn = 1 rad/s, W = 0.8."""

angles = st.floats(-20.0, 20.0)
gaps = st.floats(0.0, 2.0)


def transfer_function(nominal: Nominal) -> TransferFunction:
    wn, zeta = nominal.natural_frequency_rad_s, nominal.damping_ratio
    return TransferFunction([2 * zeta * wn, wn**2], [1.0, 2 * zeta * wn, wn**2])


def played(nominal: Nominal, commands: list[float], durations_s: list[float]) -> list[PlantOutputs]:
    """The plant's outputs before every command, and at the end."""
    plant = PaperPlant(nominal)
    outputs = [plant.outputs()]
    for command, duration in zip(commands, durations_s, strict=True):
        plant.advance(command, duration)
        outputs.append(plant.outputs())
    return outputs


@pytest.mark.parametrize("nominal", [NOMINAL, PAPER_SIMULATION])
def test_step_response_is_that_of_the_papers_transfer_function(nominal: Nominal) -> None:
    dt_s = 1e-3 / nominal.natural_frequency_rad_s * 62.5
    dt_s = round(dt_s * 1e6) * 1e-6
    n = 300
    outputs = played(nominal, [1.0] * n, [dt_s] * n)
    _, expected = step(transfer_function(nominal), T=np.arange(n + 1) * dt_s)
    velocity = [o.motor_velocity_rad_s for o in outputs]
    np.testing.assert_allclose(velocity, expected, atol=1e-9)


def test_angle_and_current_obey_the_differential_equations() -> None:
    a = NOMINAL.torque_constant_nm_per_a / NOMINAL.inertia_kg_m2
    k_p, k_i = NOMINAL.proportional_gain_a_s_per_rad, NOMINAL.integral_gain_a_per_rad

    def rates(_: float, x: np.ndarray) -> list[float]:
        return [x[1], a * (k_p * (3.0 - x[1]) + k_i * x[2]), 3.0 - x[1]]

    t = np.arange(1, 51) * 2e-3
    truth = solve_ivp(rates, (0.0, 0.1), [0.0] * 3, t_eval=t, rtol=1e-11, atol=1e-13).y
    outputs = played(NOMINAL, [3.0] * 50, [2e-3] * 50)[1:]
    np.testing.assert_allclose([o.motor_position_rad for o in outputs], truth[0], atol=1e-9)
    current = k_p * (3.0 - truth[1]) + k_i * truth[2]
    np.testing.assert_allclose([o.motor_current_a for o in outputs], current, atol=1e-8)


def test_simulation_over_slots_is_scipys_zero_order_hold() -> None:
    rng = np.random.default_rng(5)
    commands = rng.choice([-2.6, 2.6], 2000)
    system = transfer_function(NOMINAL)
    # G(s)/s: the motor's angle
    num, den, _ = cont2discrete((system.num, np.append(system.den, 0.0)), 0.008)
    expected = lfilter(np.squeeze(num), den, commands)
    simulated = simulate(NOMINAL, commands, 0.008)
    np.testing.assert_allclose(simulated.motor_angle_rad, expected, atol=1e-9)


@given(st.integers(0, 20_000))
def test_a_duration_is_played_in_whole_doublings(duration_us: int) -> None:
    lengths = step_lengths_us(duration_us)
    assert sum(lengths) == duration_us
    assert set(lengths) <= set(doubling_steps(NOMINAL))
    assert list(lengths) == sorted(lengths, reverse=True)


@given(st.integers(1, 20_000), st.data())
def test_a_split_duration_is_the_whole_one(duration_us: int, data: st.DataObject) -> None:
    at_us = data.draw(st.integers(0, duration_us))
    whole = played(NOMINAL, [2.0], [duration_us * 1e-6])[-1]
    split = played(NOMINAL, [2.0, 2.0], [at_us * 1e-6, (duration_us - at_us) * 1e-6])[-1]
    assert split.motor_position_rad == pytest.approx(whole.motor_position_rad, abs=1e-12)
    assert split.motor_velocity_rad_s == pytest.approx(whole.motor_velocity_rad_s, abs=1e-12)
    expected = exact_step(NOMINAL, duration_us * 1e-6)
    assert whole.motor_velocity_rad_s == pytest.approx(2.0 * expected.gamma[1], abs=1e-12)


@given(st.lists(angles, min_size=1, max_size=20), angles, gaps)
def test_the_load_stays_within_the_gap(path: list[float], load: float, gap: float) -> None:
    for angle in path:
        load = play(load, angle, gap)
        assert abs(load - angle) <= gap / 2 + 1e-12
        assert play(load, angle, gap) == load


@given(st.lists(angles, min_size=2, max_size=10), st.integers(1, 5), gaps)
def test_the_play_knows_no_speed(path: list[float], pieces: int, gap: float) -> None:
    direct = slow = 0.0
    for angle in path:
        direct = play(direct, angle, gap)
    for start, end in pairwise([path[0], *path]):
        for angle in np.linspace(start, end, pieces + 1)[1:-1]:
            slow = play(slow, float(angle), gap)
        slow = play(slow, end, gap)
    assert slow == pytest.approx(direct, abs=1e-12)


@given(st.lists(angles, min_size=1, max_size=10), angles, gaps)
def test_plays_in_a_row_are_one_clamp(path: list[float], load: float, gap: float) -> None:
    limits = Limits(np.array([-np.inf]), np.array([np.inf]))
    one_by_one = load
    for angle in path:
        limits = limits.then(Limits.around(np.array([angle]), gap))
        one_by_one = play(one_by_one, angle, gap)
    assert min(max(load, limits.low_rad[0]), limits.high_rad[0]) == one_by_one


def test_without_power_it_coasts() -> None:
    plant = PaperPlant(NOMINAL)
    plant.advance(5.0, 0.05)
    before = plant.outputs()
    plant.advance(None, 0.25)
    after = plant.outputs()
    assert after.motor_velocity_rad_s == before.motor_velocity_rad_s != 0.0
    assert after.motor_current_a == 0.0
    travelled = after.motor_position_rad - before.motor_position_rad
    assert travelled == pytest.approx(0.25 * before.motor_velocity_rad_s, abs=1e-12)
    assert after.load_angle_rad == pytest.approx(
        after.motor_position_rad - NOMINAL.backlash_gap_rad / 2
    )


def test_power_comes_back_with_an_empty_integrator() -> None:
    plant = PaperPlant(NOMINAL)
    plant.advance(5.0, 0.05)
    plant.advance(None, 0.01)
    velocity = plant.outputs().motor_velocity_rad_s
    plant.advance(1.0, 0.0)
    expected = NOMINAL.proportional_gain_a_s_per_rad * (1.0 - velocity)
    assert plant.outputs().motor_current_a == pytest.approx(expected)


def test_outputs_change_nothing() -> None:
    plant = PaperPlant(NOMINAL)
    plant.advance(1.0, 0.008)
    assert plant.outputs() == plant.outputs()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.1))
def test_simulation_is_the_plant_slot_by_slot(seed: int, gap_rad: float) -> None:
    rng = np.random.default_rng(seed)
    nominal = Nominal(0.03606, 0.00025, 0.3466, 27.08, gap_rad)
    commands = rng.choice([-2.6, 2.6], 40)
    durations_s = (8000 + rng.integers(-4000, 4000, 40)) * 1e-6
    outputs = played(nominal, commands.tolist(), durations_s.tolist())
    simulated = simulate(nominal, commands, durations_s)
    for name, values in (
        ("motor_position_rad", simulated.motor_angle_rad),
        ("motor_velocity_rad_s", simulated.motor_velocity_rad_s),
        ("motor_current_a", simulated.motor_current_a),
        ("load_angle_rad", simulated.load_angle_rad),
    ):
        expected = [getattr(o, name) for o in outputs]
        np.testing.assert_allclose(values, expected[:-1], atol=1e-11)
    assert simulated.end.load_angle_rad == pytest.approx(outputs[-1].load_angle_rad, abs=1e-11)


def test_a_simulation_goes_on_where_it_stopped() -> None:
    commands = np.random.default_rng(3).choice([-2.0, 2.0], 200)
    whole = simulate(NOMINAL, commands, 0.008)
    first = simulate(NOMINAL, commands[:77], 0.008)
    second = simulate(NOMINAL, commands[77:], 0.008, start=first.end)
    for name in ("motor_angle_rad", "motor_current_a", "load_angle_rad"):
        joined = np.concatenate([getattr(first, name), getattr(second, name)])
        np.testing.assert_array_equal(joined, getattr(whole, name))


def test_the_papers_own_simulation_runs() -> None:
    commands = np.random.default_rng(1).choice([-1.0, 1.0], 400)
    simulated = simulate(PAPER_SIMULATION, commands, 0.5)
    gap = simulated.motor_angle_rad - simulated.load_angle_rad
    assert np.abs(gap).max() == pytest.approx(0.4, abs=1e-12)


@pytest.mark.parametrize(
    ("commands", "durations"),
    [
        (np.zeros((2, 2)), 0.008),
        (np.zeros(3), np.full(2, 0.008)),
        (np.array([math.nan]), 0.008),
        (np.zeros(2), np.array([0.008, -0.008])),
    ],
)
def test_a_simulation_refuses_nonsense(commands: np.ndarray, durations: np.ndarray) -> None:
    with pytest.raises(RigSettingsError):
        simulate(NOMINAL, commands, durations)
