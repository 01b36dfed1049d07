"""One physical law for every effect that the ideal rig does not have, through the whole model.

Each is what a bench experiment would show, or an equation solved another way; none repeats the
effect's own line of code.
"""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from sim_rig.effects import catalogue
from sim_rig.effects.effect import Signals
from sim_rig.effects.inverter_dead_time import law as dead_time_law
from sim_rig.model import Model, Simulated, controller, mechanics
from sim_rig.settings import Nominal

K_T, J, K_P, K_I = 0.03606, 2.5e-4, 0.97, 69.0
RIGID = Nominal(K_T, J, K_P, K_I)
GAP_RAD = math.radians(1.5)
LOOSE = Nominal(K_T, J, K_P, K_I, GAP_RAD)
PERIOD_S = 0.008


def held(model: Model, command_rad_s: float, seconds: float) -> Simulated:
    """One command for so long, from rest."""
    return model.simulate(np.full(round(seconds / PERIOD_S), command_rad_s), PERIOD_S)


def levels(slots: int, seed: int = 4) -> np.ndarray:
    return np.random.default_rng(seed).choice([-6.0, -1.0, 0.0, 4.0, 6.0], slots)


def same_but_for_the_reading(name: str, **values: float) -> tuple[Simulated, Simulated]:
    """Plain and with an encoder's error; nothing but the reading may differ, not by a bit."""
    commands = levels(300) + 3.0
    plain = Model(LOOSE).simulate(commands, PERIOD_S)
    shown = Model(LOOSE).with_effect(name, **values).simulate(commands, PERIOD_S)
    for signal in ("motor_angle_rad", "motor_current_a", "true_load_angle_rad", "integral_rad"):
        assert np.array_equal(getattr(plain, signal), getattr(shown, signal)), signal
    return plain, shown


def test_every_confusion_is_mutual_and_known() -> None:
    effects = catalogue()
    for effect in effects.values():
        for name in effect.confused_with:
            assert name in effects, f"{effect.name} is confused with {name}, which does not exist"
            assert effect.name in effects[name].confused_with, f"{name} does not name {effect.name}"


class TestFriction:
    """Torque balances at constant velocity: K_T i is what friction takes."""

    @pytest.mark.parametrize("side", [1.0, -1.0])
    def test_asymmetric_takes_more_one_way(self, side: float) -> None:
        model = Model(RIGID).with_effect("coulomb", torque_nm=0.02)
        model = model.with_effect("asymmetric_friction", difference_torque_nm=0.005)
        current = held(model, 8.0 * side, 1.0).motor_current_a[-1]
        assert K_T * current == pytest.approx(side * 0.02 + 0.005, abs=1e-7)

    @pytest.mark.parametrize("side", [1.0, -1.0])
    def test_load_dependent_is_an_efficiency(self, side: float) -> None:
        """Lifting needs T / (1 - mu); lowering gives back T / (1 + mu)."""
        model = Model(RIGID).with_effect("load_torque", torque_nm=-0.05)
        model = model.with_effect("load_dependent_friction", loss_fraction=0.2)
        current = held(model, 8.0 * side, 1.0).motor_current_a[-1]
        assert K_T * current == pytest.approx(0.05 / (1.0 - side * 0.2), rel=1e-6)

    def test_position_dependent_turns_with_the_direction(self) -> None:
        """Slow full turns both ways: half the difference is friction, half the sum is nothing."""
        model = Model(RIGID).with_effect("coulomb", torque_nm=0.02)
        model = model.with_effect("position_friction", swing_torque_nm=0.008, phase_rad=0.7)

        def swing(command_rad_s: float) -> np.ndarray:
            done = held(model, command_rad_s, 8.0)
            turn = slice(round(1.0 / PERIOD_S), round((1.0 + math.tau / 2.5) / PERIOD_S) + 1)
            angle, torque = done.motor_angle_rad[turn], K_T * done.motor_current_a[turn]
            terms = np.stack((np.ones(angle.size), np.cos(angle), np.sin(angle)), axis=1)
            found: np.ndarray = np.linalg.lstsq(terms, torque, rcond=None)[0]
            return found

        forwards, backwards = swing(2.5), swing(-2.5)
        friction = [0.02, 0.008 * math.cos(0.7), 0.008 * math.sin(0.7)]
        np.testing.assert_allclose((forwards - backwards) / 2.0, friction, atol=2e-5)
        np.testing.assert_allclose((forwards + backwards) / 2.0, 0.0, atol=2e-5)

    def test_thermal_falls_with_its_time_constant(self) -> None:
        model = Model(RIGID).with_effect("thermal_friction", cold_torque_nm=0.01, warming_s=15.0)
        torque = K_T * held(model, 8.0, 32.0).motor_current_a
        one, later = round(1.0 / PERIOD_S), round(31.0 / PERIOD_S)
        assert torque[one] / torque[later] == pytest.approx(math.exp(2.0), rel=1e-4)


class TestTorqueConstant:
    """What a given current does to the motor."""

    def test_droop_halves_the_torque_where_it_says(self) -> None:
        model = Model(RIGID).with_effect("torque_constant_droop", droop_per_a2=1.0 / 12.0**2)
        motion = mechanics(model, 1e-3, np.full(101, 12.0))
        assert motion.velocity_rad_s[-1] == pytest.approx(0.5 * K_T * 12.0 / J * 0.1, rel=1e-9)
        little = mechanics(model, 1e-3, np.full(101, 0.12)).velocity_rad_s[-1]
        assert little == pytest.approx(K_T * 0.12 / J * 0.1, rel=1.1e-4)

    def test_ripple_keeps_the_energy(self) -> None:
        """J omega^2 / 2 is the integral of the torque over the angle, at any current."""
        model = Model(RIGID).with_effect(
            "torque_ripple",
            ripple_fraction=0.3,
            electrical_order=2.0,
            pole_pair_count=3.0,
            phase_rad=0.4,
        )
        for current in (1.0, 2.0):
            motion = mechanics(model, 1e-3, np.full(201, current))
            angle = motion.angle_rad
            ripple = 0.3 * (math.cos(0.4) - np.cos(6.0 * angle + 0.4)) / 6.0
            energy = K_T * current * (angle + ripple)
            kinetic = 0.5 * J * motion.velocity_rad_s**2
            np.testing.assert_allclose(kinetic[20:], energy[20:], rtol=2e-5)

    def test_ripple_needs_current(self) -> None:
        model = Model(RIGID).with_effect("torque_ripple", ripple_fraction=0.3)
        motion = mechanics(model, 1e-3, np.zeros(101), velocity_rad_s=3.0)
        np.testing.assert_array_equal(motion.velocity_rad_s, 3.0)

    def test_warm_magnets_need_more_current(self) -> None:
        model = Model(RIGID).with_effect("load_torque", torque_nm=-0.05)
        model = model.with_effect("thermal_torque_constant", drop_fraction=0.1, warming_s=5.0)
        current = held(model, 5.0, 60.0).motor_current_a
        at_5_s = 1.0 - 0.1 * (1.0 - math.exp(-1.0))
        assert K_T * current[round(5.0 / PERIOD_S)] == pytest.approx(0.05 / at_5_s, rel=1e-4)
        assert K_T * current[-1] == pytest.approx(0.05 / 0.9, rel=1e-5)


class TestCommand:
    """From the wire to the loop."""

    @pytest.mark.parametrize("step_rad_s", [8.0, -8.0, 1.0])
    def test_slew_loses_half_the_square_of_the_step(self, step_rad_s: float) -> None:
        """G(0) = 1: what the ramp lacks under the step, r^2 / 2 S, is lacking in the angle."""
        slope = 1234.5
        model = Model(RIGID).with_effect("command_slew", slowness_s2_per_rad=1.0 / slope)
        commands = np.full(100, step_rad_s)
        plain = Model(RIGID).simulate(commands, PERIOD_S)
        ramped = model.simulate(commands, PERIOD_S)
        lost = plain.motor_angle_rad[-1] - ramped.motor_angle_rad[-1]
        assert lost == pytest.approx(step_rad_s * abs(step_rad_s) / (2.0 * slope), rel=1e-6)

    def test_slew_is_never_steeper(self) -> None:
        """The mean command of every slot, from the loop's own equation, against a band."""
        slope = 300.0
        model = Model(RIGID).with_effect("command_slew", slowness_s2_per_rad=1.0 / slope)
        done = model.simulate(np.repeat(levels(100), 8), 1e-3)
        angle, integral = done.motor_angle_rad, done.integral_rad
        command = (np.diff(integral) + np.diff(angle)) / 1e-3
        assert np.abs(np.diff(command)).max() <= slope * 1e-3 * (1.0 + 1e-6)
        assert np.abs(command).max() > 5.0

    def test_deadband_swallows_what_is_small_and_only_that(self) -> None:
        model = Model(LOOSE).with_effect("command_deadband", deadband_rad_s=0.3)
        small = np.random.default_rng(1).uniform(-0.3, 0.3, 100)
        assert np.abs(model.simulate(small, PERIOD_S).motor_angle_rad).max() < 1e-14
        assert np.abs(Model(LOOSE).simulate(small, PERIOD_S).motor_angle_rad).max() > 1e-3
        large = np.where(small > 0.0, 0.3, -0.3)
        plain = Model(LOOSE).simulate(large, PERIOD_S)
        assert np.array_equal(model.simulate(large, PERIOD_S)[0], plain[0])

    def test_deadband_of_the_other_kind_begins_at_zero(self) -> None:
        """A dead zone: a command beyond the band acts as one that is less by the band."""
        zone = {"deadband_rad_s": 0.3, "offset_fraction": 1.0}
        model = Model(LOOSE).with_effect("command_deadband", **zone)
        commands = np.random.default_rng(1).uniform(-1.0, 1.0, 100)
        less = np.sign(commands) * np.maximum(np.abs(commands) - 0.3, 0.0)
        np.testing.assert_allclose(
            model.simulate(commands, PERIOD_S).load_angle_rad,
            Model(LOOSE).simulate(less, PERIOD_S).load_angle_rad,
            rtol=0,
            atol=1e-12,
        )

    def test_scale_is_a_gear(self) -> None:
        model = Model(RIGID).with_effect("command_scale", error_fraction=0.01)
        commands = levels(200)
        plain = Model(RIGID).simulate(commands, PERIOD_S)
        scaled = model.simulate(commands, PERIOD_S)
        np.testing.assert_allclose(
            scaled.load_angle_rad, 1.01 * plain.load_angle_rad, rtol=0, atol=1e-12
        )

    def test_offset_drifts_at_standstill(self) -> None:
        done = held(Model(LOOSE).with_effect("command_offset", offset_rad_s=-0.05), 0.0, 2.0)
        drift = done.load_angle_rad[-1] - done.load_angle_rad[-126]
        assert drift == pytest.approx(-0.05 * 125 * PERIOD_S, rel=1e-9)


class TestLoop:
    """Filters and limits in the loop, against other solutions of its equations."""

    def test_filtered_velocity_is_the_linear_loop_with_one_pole_more(self) -> None:
        lag_s = 1.5e-3
        system = np.zeros((5, 5))  # theta, omega, z, v, and the command, which is held
        system[0, 1] = 1.0
        system[1, 2:] = K_T * K_I / J, -K_T * K_P / J, K_T * K_P / J
        system[2, 3:] = -1.0, 1.0
        system[3, 1], system[3, 3] = 1.0 / lag_s, -1.0 / lag_s
        step, x, angles = expm(system * PERIOD_S), np.zeros(5), []
        for level in levels(60):
            angles.append(x[0])
            x[4] = level
            x = step @ x
        effect = {"velocity_filter_lag": {"lag_s": lag_s}}

        def error(longest_step_s: float) -> float:
            effects = Model.from_table(RIGID, effect).effects
            done = Model(RIGID, effects, longest_step_s).simulate(levels(60), PERIOD_S)
            return float(np.abs(done.motor_angle_rad - angles).max())

        assert error(50e-6) < 2e-6
        assert 1.8 < math.log2(error(50e-6) / error(25e-6)) < 2.3

    def test_back_calculation_while_the_current_is_limited(self) -> None:
        limit_a, tracking = 5.0, 300.0

        def rates(_t: float, x: np.ndarray) -> list[float]:
            _, omega, z = x
            asked = K_P * (8.0 - omega) + K_I * z
            given = min(max(asked, -limit_a), limit_a)
            return [omega, K_T * given / J, 8.0 - omega + tracking * (given - asked) / K_I]

        times = PERIOD_S * np.arange(20)
        reference = solve_ivp(
            *(rates, (0.0, times[-1]), np.zeros(3)),
            t_eval=times,
            max_step=1e-4,
            rtol=1e-10,
            atol=1e-12,
        )
        limited = Model(RIGID).with_effect("current_limit", limit_per_a=1.0 / limit_a)
        done = held(limited.with_effect("anti_windup", tracking_per_s=tracking), 8.0, 0.16)
        np.testing.assert_allclose(done.motor_angle_rad, reference.y[0], atol=2e-6)
        np.testing.assert_allclose(done.integral_rad, reference.y[2], atol=2e-6)
        overshoot = held(limited, 8.0, 0.16).motor_velocity_rad_s.max() - 8.0
        assert 0.0 < done.motor_velocity_rad_s.max() - 8.0 < 0.8 * overshoot

    def test_without_a_limit_nothing_winds_up(self) -> None:
        model = Model(RIGID).with_effect("anti_windup", tracking_per_s=300.0)
        plain = Model(RIGID).simulate(levels(50), PERIOD_S)
        assert np.array_equal(model.simulate(levels(50), PERIOD_S)[0], plain[0])


class TestInverterDeadTime:
    """Notches where the current changes its sign, learnt away by the current loop."""

    PLAIN = Model(Nominal(K_T, J, K_P, 0.01 * K_I))
    NOTCHED = PLAIN.with_effect("inverter_dead_time", notch_a=0.3, recovery_s=2e-3)

    def test_a_reversal_is_answered_by_a_notch_that_decays(self) -> None:
        """With the rotor locked, the current's change of sign and nothing else."""
        commands, still = np.repeat([5.0, -5.0], 100), np.zeros(201)
        plain = controller(self.PLAIN, 2e-4, commands, still, still)
        notched = controller(self.NOTCHED, 2e-4, commands, still, still)
        notch = (notched - plain)[102:160]
        assert (plain[101:201] < -3.0).all()
        at_angle_zero = math.pi / 6.0 * math.sqrt(3.0)
        decays = 0.3 * at_angle_zero * np.exp(-2e-4 * np.arange(2, 60) / 2e-3)
        np.testing.assert_allclose(notch, decays, rtol=2e-3, atol=1e-5)

    def test_a_steady_current_is_made_up_for(self) -> None:
        commands, still = np.full(200, 5.0), np.zeros(201)
        plain = controller(self.PLAIN, 2e-4, commands, still, still)
        notched = controller(self.NOTCHED, 2e-4, commands, still, still)
        assert abs(notched[-1] - plain[-1]) < 1e-6

    def test_phases_change_over_six_times_in_an_electrical_revolution(self) -> None:
        effect = catalogue()["inverter_dead_time"]
        params, memory = effect.make({"notch_a": 0.3}), effect.memory
        assert memory is not None
        angle = np.linspace(0.0, math.tau, 4 * 240, endpoint=False)
        lost = 4.0 - dead_time_law(Signals(motor_angle_rad=angle, current_a=4.0), memory(), params)
        spectrum = np.abs(np.fft.rfft(lost))
        assert set(np.flatnonzero(spectrum > 1e-6 * spectrum[0])) <= {24 * k for k in range(21)}
        assert lost.mean() == pytest.approx(0.15, rel=1e-3)
        assert np.ptp(lost) / lost.mean() == pytest.approx(
            math.pi / 3.0 * (1 - 3**0.5 / 2), rel=1e-3
        )


class TestLoad:
    """Behind the gap."""

    @pytest.mark.parametrize("side", [1.0, -1.0])
    def test_position_dependent_gap_is_seen_when_turning_slowly(self, side: float) -> None:
        model = Model(LOOSE).with_effect("position_backlash", swing_rad=0.01, phase_rad=0.6)
        done = held(model, 3.0 * side, 4.0)
        load = done.true_load_angle_rad[50:]
        behind = side * (done.motor_angle_rad[50:] - load)
        np.testing.assert_allclose(
            behind, 0.5 * (GAP_RAD + 0.01 * np.cos(load - 0.6)), rtol=0, atol=2e-6
        )
        assert np.ptp(behind) > 0.0099

    @pytest.mark.parametrize("torque_nm", [0.02, -0.02])
    def test_a_load_torque_is_held_at_standstill(self, torque_nm: float) -> None:
        model = Model(LOOSE).with_effect("load_torque", torque_nm=torque_nm)
        model = model.with_effect("load_friction", torque_nm=0.004)
        model = model.with_effect("contact", compliance_rad_per_nm=2e-3, damping_s=5e-4)
        done = held(model, 0.0, 3.0)
        ahead = done.true_load_angle_rad[-1] - done.motor_angle_rad[-1]
        side = math.copysign(1.0, torque_nm)
        assert ahead == pytest.approx(side * GAP_RAD / 2.0 + 2e-3 * torque_nm, abs=1e-6)
        assert K_T * done.motor_current_a[-1] == pytest.approx(-torque_nm, rel=1e-3)


class TestEncoder:
    """Readings, and nothing but readings."""

    def test_misalignment_is_the_joint_s_tangent(self) -> None:
        plain, shown = same_but_for_the_reading("misalignment", angle_rad=0.3, phase_rad=0.5)
        before, after = plain.load_angle_rad + 0.5, shown.load_angle_rad + 0.5
        np.testing.assert_allclose(
            np.cos(0.3) * np.sin(after) * np.cos(before),
            np.sin(before) * np.cos(after),
            rtol=0,
            atol=1e-14,
        )
        assert np.abs(after - before).max() < 0.3**2 / 3.0
        turns = np.ptp(before) / math.tau
        assert turns > 1.0

    def test_misalignment_is_two_per_revolution(self) -> None:
        plain, shown = same_but_for_the_reading("misalignment", angle_rad=0.05)
        error = shown.load_angle_rad - plain.load_angle_rad
        twice = 0.05**2 / 4.0 * np.sin(2.0 * plain.load_angle_rad)
        np.testing.assert_allclose(error, twice, rtol=0, atol=0.05**4 / 8.0)

    def test_subdivision_repeats_with_every_line(self) -> None:
        plain, shown = same_but_for_the_reading(
            "encoder_subdivision", amplitude_rad=5e-5, line_order=2048.0, phase_rad=0.2
        )
        error = shown.load_angle_rad - plain.load_angle_rad
        line = 2048.0 * plain.load_angle_rad
        terms = np.stack((np.sin(line), np.cos(line)), axis=1)
        found = np.linalg.lstsq(terms, error, rcond=None)[0]
        np.testing.assert_allclose(found, [5e-5 * math.cos(0.2), 5e-5 * math.sin(0.2)], atol=1e-12)

    def test_quantisation_is_a_lattice(self) -> None:
        count = math.tau / 10000.0
        plain, shown = same_but_for_the_reading("quantisation", count_rad=count)
        counts = shown.load_angle_rad / count
        np.testing.assert_allclose(counts, np.round(counts), rtol=0, atol=1e-9)
        error = shown.load_angle_rad - plain.load_angle_rad
        assert np.abs(error).max() <= 0.5 * count * (1.0 + 1e-9)
        assert error.std() == pytest.approx(count / math.sqrt(12.0), rel=0.1)

    def test_quantisation_comes_last(self) -> None:
        model = Model(LOOSE).with_effect("quantisation", count_rad=1e-3)
        for name in ("encoder_eccentricity", "encoder_subdivision", "misalignment"):
            model = model.with_effect(name, **catalogue()[name].sample)
        counts = model.simulate(levels(200), PERIOD_S).load_angle_rad / 1e-3
        np.testing.assert_allclose(counts, np.round(counts), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["command_slew", "inverter_dead_time", "velocity_filter_lag"])
def test_memories_are_advanced_in_second_order(name: str) -> None:
    """Corners fall anywhere in a step, so errors scatter about their order: three halvings."""
    effects = Model(RIGID).with_effect(name, **catalogue()[name].sample).effects

    def angles(longest_step_s: float) -> np.ndarray:
        model = Model(RIGID, effects, longest_step_s)
        return model.simulate(levels(60) * 1.07, PERIOD_S).motor_angle_rad

    truth = angles(1e-6)
    coarse, fine = (float(np.abs(angles(h) - truth).max()) for h in (100e-6, 12.5e-6))
    assert math.log2(coarse / fine) > 3 * 1.7, (coarse, fine)
