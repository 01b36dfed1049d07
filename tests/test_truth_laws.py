"""Each effect of the truth plant, by a law of physics that it alone obeys; signs as well as sizes.

`quiet` is the plant without friction and noise. K_T, J and the gains are the paper's.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.truth.catalogue import Scale
from tests.truth.drive import AT_REST, NOTCH_QUALITY, RIPPLE_A_PER_V, dead_time, notched
from tests.truth.effects import NONE
from tests.truth.mechanics import DEFLECTIONS, held
from tests.truth.nuisances import QUIET
from tests.truth.plant import TruthPlant
from tests.truth.rigs import PAPER, NominalRig, drawn
from tests.truth.trying import (
    K_T,
    LOOP_S,
    PERIOD_S,
    VELOCITY_RAD_S,
    J,
    harmonic,
    quiet,
    quiet_on,
    random_commands,
    steady_current_a,
)

K_P, K_I = PAPER.proportional_gain_a_s_per_rad, PAPER.integral_gain_a_per_rad
NO_GAP = replace(PAPER, backlash_gap_rad=0.0)
GAP_RAD = PAPER.backlash_gap_rad


def coasted_rad_s(duration_s: float, **strengths: float) -> tuple[float, float]:
    """Velocity at the start and end of a coast, the current already gone."""
    plant = quiet(**strengths)
    plant.advance(4.0, 0.5)
    plant.advance(None, 0.01)
    before = plant.outputs().motor_velocity_rad_s
    plant.advance(None, duration_s)
    return before, plant.outputs().motor_velocity_rad_s


# --- friction --------------------------------------------------------------------------------


@pytest.mark.parametrize("strength", ["coulomb_nm", "load_friction_nm"])
def test_coulomb_friction_of_motor_and_load_slows_evenly(strength: str) -> None:
    before, after = coasted_rad_s(0.1, **{strength: 5e-3})
    assert before - after == pytest.approx(0.1 * 5e-3 / J, rel=2e-3)


def test_viscous_friction_slows_exponentially() -> None:
    before, after = coasted_rad_s(0.2, viscous_nm_s_per_rad=1e-3)
    assert after / before == pytest.approx(math.exp(-0.2 * 1e-3 / J), rel=2e-3)


def test_air_drag_makes_the_reciprocal_of_velocity_grow_evenly() -> None:
    before, after = coasted_rad_s(0.3, air_drag_nm_s2_per_rad2=1e-3)
    assert 1.0 / after - 1.0 / before == pytest.approx(0.3 * 1e-3 / J, rel=2e-3)


def test_stribeck_friction_is_there_at_low_speed_only() -> None:
    slow, middle, fast = (
        steady_current_a(quiet(stribeck_nm=8e-3, stribeck_velocity_rad_s=0.5), w)
        for w in (0.1, 0.5, 4.0)
    )
    assert K_T * slow == pytest.approx(8e-3 * math.exp(-0.04), rel=0.01)
    assert K_T * middle == pytest.approx(8e-3 * math.exp(-1.0), rel=0.02)
    assert K_T * fast == pytest.approx(0.0, abs=1e-5)


def test_before_it_slides_the_rotor_gives_way_like_a_spring() -> None:
    coulomb_nm, breakaway_rad, pull_nm = 10e-3, 1e-3, 1e-3
    friction = {"coulomb_nm": coulomb_nm, "presliding_rad": breakaway_rad}
    plant = quiet_on(NO_GAP, load_torque_nm=pull_nm, load_friction_nm=0.1e-3, **friction)
    plant.advance(None, 3.0)
    stiffness = sum(0.25 * coulomb_nm / (breakaway_rad * d) for d in DEFLECTIONS)
    left_rad = plant.outputs().motor_position_rad
    assert left_rad == pytest.approx(-pull_nm / stiffness, rel=0.12)


def test_without_presliding_friction_holds_exactly() -> None:
    plant = quiet_on(NO_GAP, load_torque_nm=1e-3, coulomb_nm=10e-3)
    plant.advance(None, 1.0)
    assert plant.outputs().motor_position_rad == 0.0


def test_a_sliding_bristle_bears_no_more_than_coulomb_friction() -> None:
    bristles = quiet(coulomb_nm=10e-3, presliding_rad=1e-4)
    assert K_T * steady_current_a(bristles, 1.0) == pytest.approx(10e-3, rel=1e-3)


@pytest.mark.parametrize(
    "strengths",
    [{"friction_asymmetry_nm": 2e-3, "coulomb_nm": 5e-3}, {"load_torque_nm": 2e-3}],
    ids=["asymmetric_friction", "load_torque"],
)
def test_both_ways_differ_by_twice_the_asymmetry_or_the_load(strengths: dict[str, float]) -> None:
    forwards = steady_current_a(quiet(**strengths), 2.0)
    backwards = steady_current_a(quiet(**strengths), -2.0)
    assert K_T * (forwards + backwards) == pytest.approx(2 * 2e-3, rel=0.01)


def test_set_valued_friction_takes_what_it_may_on_its_own_side_and_else_holds() -> None:
    takes = {"forwards": 0.5, "backwards": 0.1}
    held_at = {0.7: 0.2, 0.3: 0.0, 0.0: 0.0, -0.05: 0.0, -0.2: -0.1, -0.6: -0.5}
    for velocity, left in held_at.items():
        assert held(velocity, **takes) == pytest.approx(left, abs=1e-12)


def test_load_dependent_friction_takes_its_share_of_the_torque() -> None:
    plant = quiet(friction_load_share=0.1)
    played = plant.play(np.full(60, 5.0), LOOP_S)
    impulse = K_T * float(played.motor_current_a[:-1].sum() + played.motor_current_a[1:].sum()) / 2
    assert J * played.motor_velocity_rad_s[-1] / (impulse * LOOP_S) == pytest.approx(0.9, rel=0.01)
    before, after = coasted_rad_s(0.2, friction_load_share=0.1)  # without current, no torque
    assert after == pytest.approx(before, abs=2e-3)


@pytest.mark.parametrize("velocity_rad_s", [1.0, -1.0])
def test_position_dependent_friction_goes_round_with_the_shaft_and_flips_with_direction(
    velocity_rad_s: float,
) -> None:
    plant = quiet(coulomb_nm=10e-3, friction_swing_nm=4e-3, friction_swing_phase_rad=0.5)
    plant.advance(velocity_rad_s, 1.0)
    played = plant.play(np.full(1571, velocity_rad_s), 0.008)
    cosine, sine = harmonic(played.motor_position_rad, played.motor_current_a, 1.0)
    side = math.copysign(1.0, velocity_rad_s)
    assert K_T * cosine == pytest.approx(side * 4e-3 * math.cos(0.5), rel=0.03)
    assert K_T * sine == pytest.approx(side * 4e-3 * math.sin(0.5), rel=0.03)


def test_a_hysteresis_brake_has_its_full_torque_only_after_its_angle() -> None:
    brake = {"hysteresis_brake_nm": 10e-3, "hysteresis_brake_rad": 0.2}
    plant = quiet(**brake)
    plant.advance(1.0, 0.6)
    turned_rad = plant.outputs().motor_position_rad
    expected_nm = 10e-3 * (1.0 - math.exp(-turned_rad / 0.2))
    assert plant.state.rotor.brake_nm == pytest.approx(expected_nm, rel=0.01)
    assert K_T * steady_current_a(plant, 1.0) == pytest.approx(10e-3, rel=0.01)


# --- torque ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("strengths", "order"),
    [
        ({"cogging_nm": 5e-3, "cogging_order": 12.0}, 12.0),
        ({"cogging_nm": 5e-3, "cogging_order": 10.0}, 10.0),
        ({"gear_mesh_nm": 5e-3, "gear_mesh_order": 6.63}, 6.63),
    ],
)
def test_cogging_and_gear_mesh_are_lines_at_their_orders(
    strengths: dict[str, float], order: float
) -> None:
    plant = quiet(**strengths)
    plant.advance(0.2, 1.0)
    played = plant.play(np.full(1571 * 5, 0.2), 0.008)
    angle, current = played.motor_position_rad, played.motor_current_a
    assert K_T * math.hypot(*harmonic(angle, current, order)) == pytest.approx(5e-3, rel=0.02)
    assert K_T * math.hypot(*harmonic(angle, current, order + 1.5)) < 0.3e-3


def test_cogging_is_the_same_at_every_turn() -> None:
    plant = quiet(cogging_nm=5e-3, cogging_order=8.0)
    table = plant.torque_nm(np.array([0.1, 0.1 + math.tau, 0.1 - 3 * math.tau]))
    assert table == pytest.approx([5e-3 * math.cos(0.8)] * 3, rel=1e-4)


def test_torque_ripple_is_in_proportion_to_the_current() -> None:
    amplitudes = []
    for load_nm in (0.0, 10e-3, 20e-3):
        plant = quiet(torque_ripple=0.05, torque_ripple_order=24.0, load_torque_nm=load_nm)
        plant.advance(0.2, 1.0)
        played = plant.play(np.full(1000, 0.2), 0.008)
        ripple = harmonic(played.motor_position_rad, played.motor_current_a, 24.0)
        amplitudes.append(K_T * math.hypot(*ripple))
    assert amplitudes == pytest.approx([0.0, 0.5e-3, 1e-3], rel=0.03, abs=20e-6)


def test_a_load_is_held_by_the_torque_constant_that_is_there() -> None:
    load = {"load_torque_nm": 50e-3}
    right = 50e-3 / K_T
    assert steady_current_a(quiet(**load), 0.5) == pytest.approx(right, rel=1e-3)
    wrong = steady_current_a(quiet(torque_constant_error=0.1, **load), 0.5)
    assert wrong == pytest.approx(right / 1.1, rel=1e-3)
    drooping = steady_current_a(quiet(torque_constant_droop_per_a2=0.05, **load), 0.5)
    assert drooping / (1.0 + 0.05 * drooping**2) == pytest.approx(right, rel=1e-3)


@pytest.mark.parametrize(
    ("strengths", "sign"),
    [
        ({"torque_constant_drift": 0.3, "torque_constant_drift_s": 3.0}, 1.0),
        ({"friction_drift": 0.5, "friction_drift_s": 3.0}, -1.0),
    ],
)
def test_thermal_drift_has_its_time_constant(strengths: dict[str, float], sign: float) -> None:
    load_torque_nm = 60e-3 if sign > 0.0 else 0.0
    plant = quiet(coulomb_nm=10e-3, load_torque_nm=load_torque_nm, **strengths)
    plant.advance(1.0, 2.0)
    torque_nm = K_T * plant.play(np.full(1000, 1.0), 0.008).motor_current_a
    held_nm = torque_nm if sign < 0.0 else -1.0 / torque_nm  # 1/i is in proportion to K_T
    first, second, third = (float(held_nm[k : k + 200].mean()) for k in (0, 375, 750))
    assert (first - second) / (second - third) == pytest.approx(math.exp(1.0), rel=0.05)
    assert sign * (third - first) > 0.0


def test_more_inertia_needs_more_impulse() -> None:
    for error in (0.0, 0.25):
        played = quiet(inertia_error=error).play(np.full(60, 5.0), LOOP_S)
        mean_a = 0.5 * (played.motor_current_a[:-1] + played.motor_current_a[1:])
        impulse = K_T * LOOP_S * float(mean_a.sum())
        inertia = impulse / float(played.motor_velocity_rad_s[-1])
        assert inertia == pytest.approx((1.0 + error) * J, rel=0.01)


# --- drive -----------------------------------------------------------------------------------


def test_the_current_never_exceeds_its_limit_and_reaches_it() -> None:
    played = quiet(current_limit_per_a=1 / 0.9).play(random_commands(500), PERIOD_S)
    fine = quiet(current_limit_per_a=1 / 0.9).play(np.repeat(random_commands(50), 64), LOOP_S)
    for current in (played.motor_current_a, fine.motor_current_a):
        assert np.abs(current).max() <= 0.9 * (1.0 + 1e-12)
    assert np.abs(fine.motor_current_a).max() > 0.89


def test_the_loop_sees_whole_counts_only() -> None:
    """Within the first count of a coarse encoder the loop is blind: i = K_P r + K_I r t."""
    coarse = QUIET._replace(motor_counts_per_revolution=16.0)
    plant = TruthPlant(PAPER, 1, NONE, coarse)
    plant.advance(1.0, 0.01)
    assert 0.0 < plant.outputs().motor_position_rad < math.tau / 16
    assert plant.outputs().motor_current_a == pytest.approx(K_P + 0.01 * K_I, rel=0.01)


def test_torque_noise_is_the_power_stages() -> None:
    plant = TruthPlant(PAPER, 1, NONE, QUIET._replace(torque_noise_nm=1e-3, load_friction_nm=1e-6))
    plant.advance(2.0, 0.5)
    noisy = plant.play(np.full(200, 2.0), LOOP_S).motor_velocity_rad_s
    plant.advance(None, 0.1)
    coasting = plant.play(np.full(200, math.nan), LOOP_S).motor_velocity_rad_s
    assert np.std(noisy) > 100 * np.std(coasting)


def test_the_current_lags() -> None:
    plant = quiet(current_lag_s=0.5e-3)
    plant.advance(1.0, LOOP_S)
    risen = 1.0 - math.exp(-LOOP_S / (0.5e-3 + QUIET.current_lag_s))
    reference_a = K_P + K_I * LOOP_S
    assert plant.outputs().motor_current_a == pytest.approx(risen * reference_a, rel=1e-9)


def test_a_velocity_filter_lags_a_ramp_by_its_time_constant() -> None:
    plant = quiet(velocity_filter_s=2e-3, coulomb_nm=20e-3)
    plant.advance(5.0, 0.5)
    plant.advance(None, 0.012)
    behind = []
    for _ in range(100):
        plant.advance(None, LOOP_S)
        state = plant.state
        behind.append(state.drive.filtered_rad_s - state.rotor.rad_s)
    slope = 20e-3 / J
    # The counts' difference itself is half a period old, and the loop began a period ago.
    assert np.mean(behind) == pytest.approx(slope * (2e-3 + 1.5 * LOOP_S), rel=0.05)


def test_a_held_velocity_changes_only_once_in_its_time() -> None:
    plant = quiet(velocity_hold_s=1e-3)
    seen = []
    for command in np.repeat(random_commands(10), 64):
        plant.advance(float(command), LOOP_S)
        seen.append(plant.state.drive.measured_rad_s)
    changes = np.flatnonzero(np.diff(seen))
    assert np.all(changes % 8 == changes[0] % 8)
    assert changes.size > 60


def test_the_integrator_stays_within_its_clamp() -> None:
    plant = quiet(integrator_clamp_per_a=1 / 0.3)
    integrals = []
    for command in random_commands(200):
        plant.advance(float(command), PERIOD_S)
        integrals.append(abs(plant.state.drive.integral_a))
    assert max(integrals) == 0.3
    free = quiet()
    free.play(np.full(2, VELOCITY_RAD_S), PERIOD_S)
    assert free.state.drive.integral_a > 0.3


@pytest.mark.parametrize("rig", [PAPER, drawn(3), drawn(4)], ids=["paper", "one", "another"])
def test_a_clamp_is_sized_by_what_the_integral_comes_to(rig: NominalRig) -> None:
    """From rest, a step of 2 V: the closed form of the loop's own equation against the plant."""
    plant, largest_a = quiet_on(replace(rig, backlash_gap_rad=0.0)), 0.0
    for _ in range(800):
        plant.advance(2.0 * VELOCITY_RAD_S, LOOP_S)
        largest_a = max(largest_a, plant.state.drive.integral_a)
    assert largest_a * Scale(rig, VELOCITY_RAD_S).of("1/integral") == pytest.approx(1.0, rel=0.03)


def test_anti_windup_takes_the_overshoot_after_the_limit() -> None:
    def overshoot(**strengths: float) -> float:
        played = quiet(current_limit_per_a=1 / 0.5, **strengths).play(np.full(4000, 5.0), LOOP_S)
        return float(played.motor_velocity_rad_s.max()) - 5.0

    assert overshoot(anti_windup_per_s=500.0) < 0.3 * overshoot()


def test_a_leaking_integrator_leaves_an_error_under_load() -> None:
    leak_per_s, load_nm = 10.0, 20e-3
    plant = quiet(integrator_leak_per_s=leak_per_s, load_torque_nm=load_nm)
    plant.advance(2.0, 4.0)
    start = plant.outputs().motor_position_rad
    plant.advance(2.0, 1.0)
    missing = 2.0 - (plant.outputs().motor_position_rad - start)
    assert missing * (K_P + K_I / leak_per_s) == pytest.approx(load_nm / K_T, rel=0.01)


def test_friction_feedforward_does_the_integrators_work() -> None:
    plant = quiet(friction_feedforward_a=0.2, coulomb_nm=0.2 * K_T)
    plant.advance(2.0, 2.0)
    assert plant.state.drive.integral_a == pytest.approx(0.0, abs=0.02)
    bare = quiet(coulomb_nm=0.2 * K_T)
    bare.advance(2.0, 2.0)
    assert bare.state.drive.integral_a == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize(("hz", "gain"), [(80.0, 0.0), (0.8, 1.0), (3900.0, 1.0)])
def test_a_notch_takes_its_own_frequency_and_no_other(hz: float, gain: float) -> None:
    effects, drive, left = NONE._replace(notch_depth=1.0, notch_hz=80.0), AT_REST, []
    wave = np.sin(math.tau * hz * LOOP_S * np.arange(40000))
    for wanted in wave.tolist():
        value, low, band = notched(effects, drive, wanted, LOOP_S)
        drive = drive._replace(notch_low_a=low, notch_band_a=band)
        left.append(value)
    assert NOTCH_QUALITY == 1.0
    assert np.std(left[20000:]) == pytest.approx(gain * np.std(wave[20000:]), abs=0.02)


def test_the_supply_sags_with_speed() -> None:
    plant = quiet(supply_sag_s_per_rad=0.05, load_torque_nm=20e-3)
    plant.advance(4.0, 2.0)
    drive = plant.state.drive
    wanted = drive.reference_a + drive.cut_off_a
    assert drive.reference_a / wanted == pytest.approx(1.0 - 0.05 * 4.0, rel=1e-3)
    assert K_T * drive.reference_a == pytest.approx(20e-3, rel=0.05)


def test_dead_time_is_a_pulse_where_the_current_changes_sign() -> None:
    effects, followed = NONE._replace(dead_time_v=1.0), 0.0
    for _ in range(1000):
        added, followed = dead_time(effects, 1.0, followed, 25e-6)
    assert added == pytest.approx(0.0, abs=1e-6)
    added, followed = dead_time(effects, -1.0, followed, 25e-6)
    assert added == pytest.approx(2.0 * RIPPLE_A_PER_V, rel=0.05)
    for _ in range(50):  # 1.25 ms: its time constant
        decayed, followed = dead_time(effects, -1.0, followed, 25e-6)
    assert decayed / added == pytest.approx(math.exp(-1.0), rel=0.01)


# --- command and clocks ----------------------------------------------------------------------


def test_a_transport_delay_shifts_all_that_follows_by_exactly_that() -> None:
    commands = np.repeat(random_commands(60), 8)
    prompt = quiet().play(commands, 1e-3)
    late = quiet(transport_delay_s=3e-3).play(commands, 1e-3)
    for channel in ("motor_position_rad", "motor_current_a", "load_angle_rad"):
        before, after = getattr(prompt, channel), getattr(late, channel)
        assert after[3:] == pytest.approx(before[:-3], abs=1e-9)


@pytest.mark.parametrize("skew", [1e-3, -1e-3])
def test_clock_skew_is_a_delay_that_grows_with_time(skew: float) -> None:
    """A command that ends at t1 ends skew t1 later, and the axis stops that much further on."""
    stops = []
    for slots in (1000, 2000):
        commands = np.append(np.full(slots, 2.0), np.zeros(100))
        right, wrong = (quiet(clock_skew=k).play(commands, PERIOD_S) for k in (0.0, skew))
        stops.append(float(wrong.motor_position_rad[-1] - right.motor_position_rad[-1]))
    ends_s = np.array([1000, 2000]) * PERIOD_S
    assert stops == pytest.approx(2.0 * skew * ends_s, abs=2.0 * LOOP_S)


def test_a_recorder_that_runs_late_cannot_be_played_command_by_command() -> None:
    with pytest.raises(ValueError, match=r"play\(\) the whole schedule"):
        quiet(clock_skew=-1e-4).advance(1.0, PERIOD_S)


def test_missed_telegrams_are_so_many_and_the_one_before_is_held() -> None:
    plant, missed = quiet(missed_probability=0.1), 0
    commands = [1.0, -1.0] * 400
    for command in commands:
        held = plant.state.drive.telegram_rad_s
        plant.advance(command, PERIOD_S)
        now = plant.state.drive.telegram_rad_s
        if now != command:
            missed += 1
            assert now == held or math.isnan(held)
    assert missed == pytest.approx(80, abs=4 * math.sqrt(72))


def test_jitter_is_late_never_early() -> None:
    plant, late = quiet(command_jitter_s=1e-3), []
    for slot in range(200):
        command = float(slot + 1)
        for part in range(64):
            plant.advance(command, LOOP_S)
            if plant.state.drive.telegram_rad_s == command:
                late.append(part * LOOP_S)
                break
        plant.advance(command, (63 - part) * LOOP_S)
    assert min(late) >= 0.0
    # The mean of a normal number's size is 0.8; the loop adds half its period.
    assert np.mean(late) == pytest.approx(0.8e-3, rel=0.2)


def test_a_drive_that_samples_its_command_does_so_on_its_own_grid() -> None:
    plant, picked = quiet(command_resampling_s=3e-3), []
    for tick in range(800):
        before = plant.state.drive.telegram_rad_s
        plant.advance(float(tick), LOOP_S)
        if plant.state.drive.telegram_rad_s != before:
            picked.append(tick)
    assert np.diff(picked).tolist() == [24] * (len(picked) - 1)


def test_a_deadband_takes_its_width_off_every_command() -> None:
    for command, expected in ((0.4, 0.0), (-0.4, 0.0), (2.0, 1.5), (-2.0, -1.5)):
        plant = quiet(command_deadband_rad_s=0.5)
        plant.advance(command, 1.0)
        assert plant.state.rotor.rad_s == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(
    ("strengths", "expected"),
    [({"command_scale_error": 0.01}, 2.02), ({"command_offset_rad_s": -0.1}, 1.9)],
)
def test_scale_and_offset_show_in_the_distance(
    strengths: dict[str, float], expected: float
) -> None:
    plant = quiet(**strengths)
    plant.advance(2.0, 1.0)
    start = plant.outputs().motor_position_rad
    plant.advance(2.0, 5.0)
    assert plant.outputs().motor_position_rad - start == pytest.approx(5 * expected, rel=1e-4)


def test_a_slew_limit_makes_ramps_of_its_slope() -> None:
    plant, seen = quiet(command_slew_s2_per_rad=1 / 400.0), []
    for _ in range(64):
        plant.advance(2.0, LOOP_S)
        seen.append(plant.state.drive.command_rad_s)
    steps = np.diff([0.0, *seen])
    assert steps.max() == pytest.approx(400.0 * LOOP_S)
    assert np.count_nonzero(steps > 1e-9) == round(2.0 / 400.0 / LOOP_S)
    assert seen[-1] == 2.0


# --- from rotor to load ----------------------------------------------------------------------


def shown_gap_rad(**strengths: float) -> float:
    """What a slow reversal shows of the gap, the shaft's friction holding the load."""
    plant = quiet(load_friction_nm=0.3e-3, **strengths)
    twists = []
    for velocity in (0.2, -0.2):
        plant.advance(velocity, 1.5)
        outputs = plant.outputs()
        twists.append(outputs.motor_position_rad - outputs.load_angle_rad)
    return twists[0] - twists[1]


def test_a_gap_is_as_wide_as_it_is() -> None:
    right = shown_gap_rad()
    assert right == pytest.approx(GAP_RAD, rel=0.01)
    assert shown_gap_rad(backlash_error_rad=4e-3) - right == pytest.approx(4e-3, rel=0.01)


def test_a_gap_that_swings_is_wide_here_and_narrow_there() -> None:
    narrow, wide = (
        shown_gap_rad(backlash_swing_rad=5e-3, backlash_swing_phase_rad=phase)
        for phase in (math.pi, 0.0)
    )
    # Between both flanks' sightings the load turns up to 0.3 rad: cos 0.3 = 0.955.
    assert wide - narrow == pytest.approx(2 * 5e-3, rel=0.05)


def test_a_gap_that_warms_widens_with_its_time_constant() -> None:
    gap = shown_gap_rad(backlash_warming=0.5, backlash_warming_s=1.5)
    forwards, backwards = (1.0 + 0.5 * (1.0 - math.exp(-t)) for t in (1.0, 2.0))
    assert gap == pytest.approx(GAP_RAD * (forwards + backwards) / 2, rel=0.01)


def test_the_contact_gives_way_as_hertz_says() -> None:
    for softness in (0.0, 10e-3):
        plant = quiet_on(NO_GAP, load_torque_nm=20e-3, contact_softness_rad15_per_nm=softness)
        plant.advance(0.0, 2.0)
        outputs = plant.outputs()
        per_stiffness = 1.0 / QUIET.contact_stiffness_nm_per_rad15 + softness
        expected = math.pow(20e-3 * per_stiffness, 2.0 / 3.0)
        pressed = outputs.motor_position_rad - outputs.load_angle_rad
        assert pressed == pytest.approx(expected, rel=0.01)


def test_a_damped_contact_returns_less() -> None:
    """The load lies on a flank, the motor hits it with the other: how fast does it leave?"""

    def leaving_rad_s(damping: float) -> float:
        plant = quiet(contact_damping_s_per_rad=damping, load_inertia_kg_m2=1e-6)
        plant.advance(2.0, 0.0)
        played = plant.play(np.full(400, 2.0), LOOP_S)
        return float(np.diff(played.load_angle_rad).max()) / LOOP_S

    hard, soft = leaving_rad_s(0.0), leaving_rad_s(5.0)
    assert 2.0 < soft < hard < 4.5


def test_the_contact_never_pulls() -> None:
    friction_nm = 0.03e-3
    sticky = {"contact_damping_s_per_rad": 1000.0, "load_friction_nm": friction_nm}
    plant = quiet(**sticky)
    plant.advance(VELOCITY_RAD_S, 0.5)
    # The motor falls back faster than friction slows the load: the sticky contact opens.
    fine_s = QUIET.step_s
    angle = plant.play(np.full(100, -VELOCITY_RAD_S), fine_s).load_angle_rad
    acceleration = np.diff(angle, 2) / fine_s**2
    assert acceleration.min() >= -1.01 * friction_nm / QUIET.load_inertia_kg_m2


def test_a_coupling_twists_under_load_and_rings_at_its_resonance() -> None:
    compliance, share = 1 / 50.0, 0.3
    still = quiet(coupling_compliance_rad_per_nm=compliance, load_torque_nm=20e-3)
    still.advance(0.0, 2.0)
    state = still.state
    assert state.rotor.rad - state.driver.rad == pytest.approx(20e-3 * compliance, rel=1e-3)
    plant = quiet(coupling_compliance_rad_per_nm=compliance)
    plant.advance(5.0, 0.003)
    plant.advance(None, 0.001)
    ringing = plant.play(np.full(4096, math.nan), LOOP_S).motor_velocity_rad_s
    spectrum = np.abs(np.fft.rfft((ringing - ringing.mean()) * np.hanning(ringing.size)))
    found_hz = np.fft.rfftfreq(ringing.size, LOOP_S)[int(spectrum.argmax())]
    reduced = share * (1.0 - share) * J
    expected_hz = math.sqrt(1.0 / compliance / reduced) / math.tau
    assert found_hz == pytest.approx(expected_hz, abs=2.5)


def test_a_loose_hub_slips_only_above_its_torque_and_bears_no_more() -> None:
    load = {"load_inertia_kg_m2": 2e-5, "load_friction_nm": 10e-3}
    tight = quiet(slip_per_nm=1 / 10.0, **load)
    tight.play(random_commands(300), PERIOD_S)
    assert tight.state.load.slip_rad == 0.0
    loose = quiet(slip_per_nm=1 / 40e-3, **load)
    angle = loose.play(np.repeat(random_commands(300), 64), LOOP_S).load_angle_rad
    assert loose.state.load.slip_rad != 0.0
    strongest = np.abs(np.diff(angle, 2)).max() / LOOP_S**2 * (2e-5 + QUIET.load_inertia_kg_m2)
    assert strongest <= 50e-3 * 1.02  # the screw's and friction's together


def test_inertia_behind_the_gap_is_the_wholes_own() -> None:
    load_kg_m2 = 2e-5 + QUIET.load_inertia_kg_m2
    plant = quiet(load_inertia_kg_m2=2e-5, coulomb_nm=5e-3)

    def momentum() -> float:
        state = plant.state
        return (J - load_kg_m2) * state.rotor.rad_s + load_kg_m2 * state.load.rad_s

    plant.advance(4.0, 0.5)
    plant.advance(None, 0.01)
    before = momentum()
    plant.advance(None, 0.1)
    assert before - momentum() == pytest.approx(0.1 * 5e-3, rel=1e-3)


def test_gravity_is_held_by_a_sine_of_the_angle() -> None:
    plant = quiet(gravity_nm=20e-3, gravity_phase_rad=0.4)
    angles, currents = [], []
    for _ in range(12):
        plant.advance(1.0, 0.5)
        currents.append(steady_current_a(plant, 0.0))
        angles.append(plant.outputs().load_angle_rad)
    expected = 20e-3 * np.sin(np.array(angles) + 0.4)
    assert K_T * np.array(currents) == pytest.approx(expected, abs=0.1e-3)
    assert max(angles) - min(angles) > 5.0


# --- load encoder ----------------------------------------------------------------------------


def encoder_error_rad(**strengths: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, true angle, and what the encoder adds to it, over two turns."""
    commands = np.full(2000, 1.0)
    true = quiet().play(commands, PERIOD_S).load_angle_rad
    reported = quiet(**strengths).play(commands, PERIOD_S).load_angle_rad
    return PERIOD_S * np.arange(2000), true, reported - true


def test_eccentricity_is_a_sine_once_per_turn() -> None:
    _, angle, error = encoder_error_rad(eccentricity_rad=1e-3, eccentricity_phase_rad=0.3)
    assert error == pytest.approx(1e-3 * np.sin(angle + 0.3), abs=1e-12)


def test_misalignment_is_twice_per_turn_and_of_the_joints_size() -> None:
    _, angle, error = encoder_error_rad(misalignment_rad=0.05)
    assert np.tan(angle + error) == pytest.approx(np.tan(angle) / math.cos(0.05), rel=1e-6)
    cosine, sine = harmonic(angle, error, 2.0)
    assert math.hypot(cosine, sine) == pytest.approx(math.tan(0.025) ** 2, rel=1e-3)


def test_subdivision_is_a_sine_of_every_line() -> None:
    _, angle, error = encoder_error_rad(subdivision_rad=1e-4, subdivision_lines=512.0)
    assert error == pytest.approx(1e-4 * np.sin(512.0 * angle), abs=1e-12)


def test_a_coarse_encoder_reports_whole_quanta() -> None:
    _, angle, error = encoder_error_rad(quantum_rad=1e-3)
    quanta = (angle + error) / 1e-3
    assert quanta == pytest.approx(np.rint(quanta), abs=1e-6)
    assert error.min() > -1e-3 - 1e-12
    assert error.max() <= 1e-12


def test_the_floor_shakes_at_its_frequency() -> None:
    time_s, _, error = encoder_error_rad(vibration_rad=0.5e-3, vibration_hz=23.0)
    assert error == pytest.approx(0.5e-3 * np.sin(math.tau * 23.0 * time_s), abs=1e-12)


def test_the_bracket_creeps_under_torque() -> None:
    creep = {"creep_rad_per_nm": 0.1, "creep_s": 0.5}
    plant, stiff = (quiet(load_torque_nm=20e-3, **c) for c in (creep, {}))
    reported = [p.play(np.zeros(500), PERIOD_S).load_angle_rad for p in (plant, stiff)]
    error = reported[0] - reported[1]
    assert error[-1] == pytest.approx(-0.1 * 20e-3, rel=0.01)
    late = error[125:375:125] - error[-1]
    assert late[0] / late[1] == pytest.approx(math.exp(2.0), rel=0.1)


def test_bit_errors_come_in_bursts_of_one_bit() -> None:
    _, _, error = encoder_error_rad(bit_errors_per_s=1.0)
    wrong = np.abs(error[np.abs(error) > 1e-9])
    bits = np.log2(wrong / (math.tau / 65536))
    assert bits == pytest.approx(np.rint(bits), abs=1e-6)
    starts = int(np.count_nonzero(np.diff((np.abs(error) > 1e-9).astype(int)) == 1))
    assert 5 <= starts <= 30
    assert wrong.size == pytest.approx(3 * starts, abs=starts)
