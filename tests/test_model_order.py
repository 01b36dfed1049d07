"""The stepping against scipy's DOP853 with events, which shares nothing with it but the equations.

Second order everywhere, and at the step in use halving it changes every signal by less than a
tenth of the smallest effect that a diagnosis is asked to name: 2.5e-5 rad of load angle.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim_rig.effects.effect import Effect
from sim_rig.model import Model, Simulated
from sim_rig.settings import Nominal
from tests.contract_effect import ALL

NOMINAL = Nominal(0.03606, 2.5e-4, 0.97, 69.0, math.radians(1.5))
SMALLEST_NAMED_RAD = 2.5e-5
LEVELS = np.random.default_rng(2).choice([-6.0, 6.0], 24)
LONG = np.random.default_rng(1).choice([-5.0, 5.0], 512)
"""Long enough for what adds up, and for a few grazing impacts."""
PERIOD_S = 0.008

Event = Callable[[float, np.ndarray], float]

SMOOTH = {
    "coulomb": {"torque_nm": 0.01},
    "viscous": {"damping_nm_s_per_rad": 1e-3},
    "stribeck": {"excess_torque_nm": 0.005, "transition_rad_s": 0.5},
    "cogging": {"torque_nm": 0.008, "order": 24.0, "second_torque_nm": 0.004, "phase_rad": 0.3},
    "torque_constant_error": {"error_fraction": 0.1},
    "inertia_error": {"error_fraction": -0.1},
    "pre_sliding": {"torque_nm": 0.004, "breakaway_angle_rad": 1e-3},
    "current_loop_lag": {"lag_s": 3e-4},
}


def smooth_rig(_t: float, x: np.ndarray, r: float) -> np.ndarray:
    """d/dt of (theta, omega, z, bristle, current) with the effects of SMOOTH, written anew."""
    theta, omega, z, bend, current = x
    friction = (
        0.01 * math.tanh(omega / 0.5)
        + 1e-3 * omega
        + 0.005 * math.exp(-((omega / 1.0) ** 2)) * math.tanh(omega / 0.5)
        + 0.004 * bend
    )
    cogging = 0.008 * math.sin(24 * theta + 0.3) + 0.004 * math.sin(12 * theta)
    torque = 1.1 * NOMINAL.torque_constant_nm_per_a * current + cogging - friction
    asked = NOMINAL.proportional_gain_a_s_per_rad * (r - omega)
    asked += NOMINAL.integral_gain_a_per_rad * z
    return np.array(
        [
            *(omega, torque / (0.9 * NOMINAL.inertia_kg_m2), r - omega),
            *((omega - abs(omega) * bend) / 1e-3, (asked - current) / 3e-4),
        ]
    )


def smooth_reference() -> tuple[np.ndarray, np.ndarray]:
    """(theta, omega, z, bend, current) and the load's angle at every slot's start."""
    half, load = NOMINAL.backlash_gap_rad / 2.0, 0.0
    states, loads = [], []
    x = np.zeros(5)
    for level in LEVELS:
        states.append(x)
        loads.append(load)

        def turns(_t: float, y: np.ndarray, _r: float) -> float:
            return float(y[1])

        done = solve_ivp(
            *(smooth_rig, (0.0, PERIOD_S), x, "DOP853"),
            events=turns,
            args=(level,),
            rtol=1e-12,
            atol=1e-13,
        )
        turned = [y[0] for y in done.y_events[0]]
        x = done.y[:, -1]
        for theta in (*turned, x[0]):
            load = min(max(load, theta - half), theta + half)
    return np.array(states), np.array(loads)


def test_second_order_with_eight_effects_on() -> None:
    states, loads = smooth_reference()

    def errors(longest_step_s: float) -> np.ndarray:
        model = Model.from_table(NOMINAL, SMOOTH)
        done = Model(NOMINAL, model.effects, longest_step_s).simulate(LEVELS, PERIOD_S)
        return np.array(
            [
                np.abs(done.motor_angle_rad - states[:, 0]).max(),
                np.abs(done.motor_velocity_rad_s - states[:, 1]).max(),
                np.abs(done.motor_current_a[1:] - states[1:, 4]).max(),
                np.abs(done.load_angle_rad - loads).max(),
            ]
        )

    at_100, at_50, at_25 = errors(100e-6), errors(50e-6), errors(25e-6)
    assert at_50[3] < SMALLEST_NAMED_RAD / 10.0
    for orders in (np.log2(at_100 / at_50), np.log2(at_50 / at_25)):
        assert (orders > 1.8).all(), orders
        assert (orders < 2.3).all(), orders


STIFFNESS, DAMPING_S, LOAD_INERTIA, LOAD_FRICTION = 500.0, 5e-4, 5e-6, 2e-3


def test_contact_is_second_order_with_impacts() -> None:
    """Two masses and a gap: the reference is cut where a face is met or let go."""
    half = NOMINAL.backlash_gap_rad / 2.0
    motor_inertia = NOMINAL.inertia_kg_m2 - LOAD_INERTIA

    def faces(x: np.ndarray, side: float) -> tuple[float, float]:
        pressed = side * (x[0] - x[3]) - half
        return pressed, pressed + DAMPING_S * side * (x[1] - x[4])

    def derivative(_t: float, x: np.ndarray, r: float, side: float) -> np.ndarray:
        contact = side * STIFFNESS * faces(x, side)[1] if side else 0.0
        current = NOMINAL.proportional_gain_a_s_per_rad * (r - x[1])
        current += NOMINAL.integral_gain_a_per_rad * x[2]
        torque = NOMINAL.torque_constant_nm_per_a * current - contact
        load = contact - LOAD_FRICTION * math.tanh(x[4] / 0.5)
        return np.array([x[1], torque / motor_inertia, r - x[1], x[4], load / LOAD_INERTIA])

    x, side = np.zeros(5), 0.0
    states = []
    for level in LEVELS:
        states.append(x)
        t = 0.0
        while t < PERIOD_S - 1e-15:
            watched = watch(faces, side)
            done = solve_ivp(
                *(derivative, (t, PERIOD_S), x, "DOP853"),
                events=watched,
                args=(level, side),
                rtol=1e-11,
                atol=1e-13,
            )
            t, x = float(done.t[-1]), done.y[:, -1]
            if done.status == 1:
                side = after(done.t_events, side)
    reference = np.array(states)

    def errors(longest_step_s: float) -> np.ndarray:
        model = Model(NOMINAL, longest_step_s=longest_step_s).with_effect(
            "contact",
            compliance_rad_per_nm=1.0 / STIFFNESS,
            damping_s=DAMPING_S,
            load_inertia_kg_m2=LOAD_INERTIA,
        )
        model = model.with_effect("load_friction", torque_nm=LOAD_FRICTION)
        done = model.simulate(LEVELS, PERIOD_S)
        return np.array(
            [
                np.abs(done.motor_angle_rad - reference[:, 0]).max(),
                np.abs(done.true_load_angle_rad - reference[:, 3]).max(),
            ]
        )

    # Impacts fall anywhere in a step, so errors scatter about their order: four halvings.
    at_50, at_3 = errors(50e-6), errors(3.125e-6)
    assert at_50[1] < SMALLEST_NAMED_RAD / 10.0, at_50
    assert (np.log2(at_50 / at_3) > 4 * 1.5).all(), (at_50, at_3)


def watch(faces: Callable[..., tuple[float, float]], side: float) -> list[Event]:
    """In the gap: either face met. On a face: its force gone."""

    def up(_t: float, x: np.ndarray, *_: float) -> float:
        return faces(x, 1.0)[0]

    def down(_t: float, x: np.ndarray, *_: float) -> float:
        return faces(x, -1.0)[0]

    def gone(_t: float, x: np.ndarray, *_: float) -> float:
        return faces(x, side)[1]

    events = [gone] if side else [up, down]
    for event in events:
        event.terminal = True  # type: ignore[attr-defined]
        event.direction = -1.0 if side else 1.0  # type: ignore[attr-defined]
    return list(events)


def after(t_events: list[np.ndarray], side: float) -> float:
    """Which face it lies on after the event."""
    if side:
        return 0.0
    return 1.0 if t_events[0].size else -1.0


def halved(effect: Effect, longest_step_s: float) -> Simulated:
    """With the load held by some friction: what bounces for ever is not to be foretold."""
    beside = Model.from_table(NOMINAL, {"load_friction": {"torque_nm": 3e-3}, **effect.beside})
    effects = beside.with_effect(effect.name, **effect.sample).effects
    return Model(NOMINAL, effects, longest_step_s).simulate(LONG, PERIOD_S)


@pytest.mark.parametrize("effect", ALL, ids=lambda effect: effect.name)
def test_halving_the_step_changes_less_than_a_tenth_of_what_is_named(effect: Effect) -> None:
    whole, half = halved(effect, 50e-6), halved(effect, 25e-6)
    for signal in ("motor_angle_rad", "load_angle_rad"):
        change = np.abs(getattr(whole, signal) - getattr(half, signal)).max()
        assert change < SMALLEST_NAMED_RAD / 10.0, signal
