"""Without effects the model is G(s) and the play operator; each block is its part of it."""

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lti

from sim_rig.errors import EffectError, SimulationError
from sim_rig.model import Model, controller, mechanics, simulate_many, transmission
from sim_rig.settings import Nominal

NOMINAL = Nominal(0.03606, 2.5e-4, 0.97, 69.0, math.radians(1.5))
RNG_SEED = 11


def commands(slots: int) -> np.ndarray:
    return np.random.default_rng(RNG_SEED).choice([-5.0, 5.0], slots)


def linear_response(levels: np.ndarray, period_s: float, oversampling: int) -> np.ndarray:
    """theta from a zero-order hold of G(s)/s by one matrix exponential; an independent route."""
    wn, zeta = NOMINAL.natural_frequency_rad_s, NOMINAL.damping_ratio
    system = lti([2.0 * zeta * wn, wn**2], [1.0, 2.0 * zeta * wn, wn**2, 0.0]).to_ss()
    augmented = np.zeros((4, 4))
    augmented[:3, :3], augmented[:3, 3:] = system.A, system.B
    step = expm(augmented * period_s / oversampling)
    x, theta = np.zeros(4), []
    for level in np.repeat(levels, oversampling):
        theta.append((system.C @ x[:3]).item())
        x[3] = level
        x = step @ x
    return np.array([*theta, (system.C @ x[:3]).item()])


def test_the_motor_is_g_of_s() -> None:
    done = Model(NOMINAL).simulate(commands(400), 0.008)
    theta = linear_response(commands(400), 0.008, 1)[:-1]
    np.testing.assert_allclose(done.motor_angle_rad, theta, rtol=0, atol=1e-9)


def test_the_load_is_the_play_of_the_motor() -> None:
    """Against the operator applied to the motor's angle at 4096 instants in every slot."""
    fine = 4096
    theta = linear_response(commands(60), 0.008, fine)
    load, half, angles = 0.0, NOMINAL.backlash_gap_rad / 2.0, []
    for k, angle in enumerate(theta[:-1]):
        load = min(max(load, angle - half), angle + half)
        if k % fine == 0:
            angles.append(load)
    done = Model(NOMINAL).simulate(commands(60), 0.008)
    np.testing.assert_allclose(done.load_angle_rad, angles, rtol=0, atol=1e-9)


def test_the_length_of_the_step_does_not_matter() -> None:
    coarse = Model(NOMINAL, longest_step_s=400e-6).simulate(commands(200), 0.008)
    fine = Model(NOMINAL, longest_step_s=10e-6).simulate(commands(200), 0.008)
    np.testing.assert_allclose(coarse.motor_angle_rad, fine.motor_angle_rad, atol=1e-12)


def test_slots_may_be_cut_anywhere() -> None:
    whole = Model(NOMINAL).simulate([5.0, -5.0], [0.008, 0.008])
    cut = Model(NOMINAL).simulate([5.0, 5.0, -5.0, -5.0, -5.0], [0.0031, 0.0049, 0.0, 0.008, 0.0])
    np.testing.assert_allclose(cut.end.recorded, whole.end.recorded, rtol=0, atol=1e-12)


def test_a_simulation_goes_on_where_it_stopped() -> None:
    model = Model(NOMINAL).with_effect("current_loop_lag", lag_s=3e-4)
    model = model.with_effect("transport_delay", delay_s=0.0123)
    levels = commands(50)
    whole = model.simulate(levels, 0.008)
    first = model.simulate(levels[:20], 0.008)
    second = model.simulate(levels[20:], 0.008, first.end)
    assert np.array_equal(whole.load_angle_rad[20:], second.load_angle_rad)
    assert whole.end == second.end


def test_the_plant_steps_the_same_bits() -> None:
    model = Model(NOMINAL).with_effect("coulomb", torque_nm=0.01)
    model = model.with_effect("contact", compliance_rad_per_nm=2e-3)
    rng = np.random.default_rng(RNG_SEED)
    durations = 0.008 + 1e-6 * rng.integers(-40, 40, 100)
    done = model.simulate(commands(100), durations)
    plant, outputs = model.plant(), []
    for level, duration in zip(commands(100), durations, strict=True):
        outputs.append(plant.outputs())
        plant.advance(level, duration)
    assert [o.load_angle_rad for o in outputs] == done.load_angle_rad.tolist()
    assert [o.motor_current_a for o in outputs] == done.motor_current_a.tolist()
    assert plant.state() == done.end


def test_the_plant_steps_the_same_bits_in_a_gap_that_changes() -> None:
    model = Model(NOMINAL).with_effect("position_backlash", swing_rad=4e-3)
    model = model.with_effect("gravity_imbalance", torque_nm=0.02)
    done, plant, outputs = model.simulate(commands(100), 0.008), model.plant(), []
    for level in commands(100):
        outputs.append(plant.outputs())
        plant.advance(level, 0.008)
    assert [o.load_angle_rad for o in outputs] == done.load_angle_rad.tolist()
    assert [o.motor_current_a for o in outputs] == done.motor_current_a.tolist()


def test_a_rigs_clock_begins_with_its_first_command() -> None:
    model = Model(NOMINAL).with_effect("clock_skew", skew_fraction=1e-4)
    model = model.with_effect("thermal_friction", cold_torque_nm=0.02)
    at_once, late = model.plant(), model.plant()
    late.advance(None, 3600.0)
    for level in commands(30):
        for plant in (at_once, late):
            plant.advance(level, 0.008)
        assert late.outputs() == at_once.outputs()
    late.advance(None, 60.0)  # without power, but begun: it goes on
    assert late.state().time_s == pytest.approx(30 * 0.008 + 60.0)


def test_a_state_in_motion_keeps_its_integral_however_late_commands_act() -> None:
    begun = {"motor_velocity_rad_s": 5.0, "integral_rad": 0.05, "command_rad_s": 5.0}
    for model in (Model(NOMINAL), Model(NOMINAL).with_effect("transport_delay", delay_s=2e-3)):
        state = model.state(**begun)
        assert (state.values[2], state.values[5], state.values[9]) == (0.05, 5.0, 0.0)


def test_a_window_is_played_by_the_time_at_which_it_begins() -> None:
    """Friction that warms: the second half alone is the second half of the whole."""
    model = Model(NOMINAL).with_effect("thermal_friction", cold_torque_nm=0.02, warming_s=3.0)
    model = model.with_effect("thermal_torque_constant", drop_fraction=0.2, warming_s=3.0)
    current = 0.5 * np.sin(2.0 * np.pi * 2.0 * 1e-3 * np.arange(6001))
    whole, half = mechanics(model, 1e-3, current), 3000
    angle, velocity = float(whole.angle_rad[half]), float(whole.velocity_rad_s[half])
    begun = {"angle_rad": angle, "velocity_rad_s": velocity}
    part = mechanics(model, 1e-3, current[half:], **begun, time_s=3.0)
    np.testing.assert_allclose(part.angle_rad, whole.angle_rad[half:], atol=1e-6)
    cold = mechanics(model, 1e-3, current[half:], **begun)
    assert np.abs(cold.angle_rad - whole.angle_rad[half:]).max() > 1e-2
    shown = controller(model, 1e-3, np.full(half, 0.0), whole.angle_rad[half:], time_s=3.0)
    assert np.isfinite(shown).all()


def test_a_load_that_is_pushed_steadily_moves_at_every_look() -> None:
    model = Model(NOMINAL).with_effect("load_friction", torque_nm=0.01)
    done = model.simulate(np.full(200, 3.0), 0.008)
    np.testing.assert_allclose(done.load_velocity_rad_s[100:], 3.0, rtol=1e-3)
    np.testing.assert_allclose(done.contact_torque_nm[100:], 0.01, rtol=1e-3)


def test_starts_are_one_for_each_model() -> None:
    with pytest.raises(SimulationError, match="1 starts for 2 models"):
        simulate_many([Model(NOMINAL)] * 2, commands(5), 0.008, [Model(NOMINAL).at_rest()])


def test_without_power_it_coasts() -> None:
    plant = Model(NOMINAL).plant()
    plant.advance(5.0, 0.5)
    before = plant.outputs()
    plant.advance(None, 0.1)
    after = plant.outputs()
    assert after.motor_velocity_rad_s == before.motor_velocity_rad_s
    assert after.motor_current_a == 0.0
    travelled = after.motor_position_rad - before.motor_position_rad
    assert travelled == pytest.approx(0.1 * before.motor_velocity_rad_s, abs=1e-12)


def test_friction_stops_what_coasts() -> None:
    model = Model(NOMINAL).with_effect("viscous", damping_nm_s_per_rad=5e-3)
    plant = model.with_effect("pre_sliding", torque_nm=0.02).plant()
    plant.advance(5.0, 0.5)
    plant.advance(None, 1.0)
    assert abs(plant.outputs().motor_velocity_rad_s) < 1e-6


class TestBlocks:
    """Every block, given what the closed loop gave it, answers as the closed loop did."""

    MODEL = (
        Model(NOMINAL)
        .with_effect("coulomb", torque_nm=0.01)
        .with_effect("current_limit", limit_per_a=1.0 / 8.0)
        .with_effect("encoder_eccentricity", amplitude_rad=1e-3)
    )
    PERIOD_S = 2e-4
    LEVELS = np.repeat(commands(20), 40)

    def test_controller(self) -> None:
        done = self.MODEL.simulate(self.LEVELS, self.PERIOD_S)
        current = controller(
            *(self.MODEL, self.PERIOD_S, self.LEVELS[:-1]),
            *(done.motor_angle_rad, done.motor_velocity_rad_s),
        )
        np.testing.assert_allclose(current[1:], done.motor_current_a[1:], atol=2e-4)

    def test_mechanics(self) -> None:
        """The current between edges is a straight line only nearly: compare within one chip."""
        done = self.MODEL.simulate(self.LEVELS, self.PERIOD_S)
        chip = slice(121, 160)
        motion = mechanics(
            *(self.MODEL, self.PERIOD_S, done.motor_current_a[chip]),
            angle_rad=done.motor_angle_rad[121],
            velocity_rad_s=done.motor_velocity_rad_s[121],
        )
        np.testing.assert_allclose(motion.angle_rad, done.motor_angle_rad[chip], atol=2e-6)
        np.testing.assert_allclose(
            motion.velocity_rad_s, done.motor_velocity_rad_s[chip], atol=1e-3
        )

    def test_transmission(self) -> None:
        done = self.MODEL.simulate(self.LEVELS, self.PERIOD_S)
        load = transmission(
            *(self.MODEL, self.PERIOD_S, done.motor_angle_rad, done.motor_velocity_rad_s)
        )
        np.testing.assert_allclose(load, done.load_angle_rad, atol=1e-8)
        by_angle_alone = transmission(self.MODEL, self.PERIOD_S, done.motor_angle_rad)
        np.testing.assert_allclose(by_angle_alone, done.load_angle_rad, atol=1e-5)

    def test_shapes_are_checked(self) -> None:
        with pytest.raises(SimulationError, match="one for each slot between"):
            controller(self.MODEL, 0.001, np.zeros(5), np.zeros(5))
        with pytest.raises(SimulationError, match="at least two finite samples"):
            transmission(self.MODEL, 0.001, [0.0, math.nan])


def test_many_models_at_once() -> None:
    models = [Model(NOMINAL).with_effect("coulomb", torque_nm=t) for t in (0.0, 0.01, 0.02)]
    together = simulate_many(models, commands(50), 0.008)
    for model, done in zip(models, together, strict=True):
        assert np.array_equal(done.load_angle_rad, model.simulate(commands(50), 0.008)[3])


def test_a_table_and_back() -> None:
    model = Model(NOMINAL).with_effect("cogging", torque_nm=0.01, order=12.0)
    table = model.to_table()
    assert table == {"cogging": {"torque_nm": 0.01, "order": 12.0}}
    assert Model.from_table(NOMINAL, table) == model
    assert model.without("cogging") == Model(NOMINAL)


def test_what_cannot_be_simulated_is_refused() -> None:
    model = Model(NOMINAL)
    with pytest.raises(SimulationError, match="finite"):
        model.simulate([math.nan], 0.008)
    with pytest.raises(SimulationError, match="one duration for each"):
        model.simulate([1.0, 2.0], [0.008] * 3)
    with pytest.raises(SimulationError, match="not negative"):
        model.simulate([1.0], -0.008)
    with pytest.raises(SimulationError, match="longest_step_s"):
        Model(NOMINAL, longest_step_s=0.0)
    with pytest.raises(SimulationError, match="64 commands"):
        model.with_effect("transport_delay", delay_s=0.4).simulate(commands(400), 0.001)
    with pytest.raises(EffectError, match="part of the total"):
        model.with_effect("contact", compliance_rad_per_nm=1e-3, load_inertia_kg_m2=1.0)
    with pytest.raises(EffectError, match="give its Params"):
        Model(NOMINAL, {"coulomb": {"torque_nm": 0.01}})
    stiff = model.with_effect("viscous", damping_nm_s_per_rad=1e3)
    with pytest.raises(SimulationError, match="ran away"):
        stiff.simulate(commands(500), 0.008)
