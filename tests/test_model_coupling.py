"""A coupling that twists, beside references that share nothing with the model but its equations.

rotor J - J_c | spring k, damper k h | J_c | gap | load (massless, or a mass behind soft faces)
"""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from sim_rig.errors import EffectError
from sim_rig.model import Model, transmission
from sim_rig.settings import Nominal
from tests.test_model_order import DAMPING_S as FACE_DAMPING_S
from tests.test_model_order import LEVELS, PERIOD_S, SMALLEST_NAMED_RAD, STIFFNESS

NOMINAL = Nominal(0.03606, 2.5e-4, 0.97, 69.0, math.radians(1.5))
RIGID = Nominal(0.03606, 2.5e-4, 0.97, 69.0)
COMPLIANCE, DAMPING_TIME_S, BEHIND = 5e-3, 2e-5, 5e-5
FINE = 512


def coupled(nominal: Nominal, **changed: float) -> Model:
    values = {
        "compliance_rad_per_nm": COMPLIANCE,
        "damping_s": DAMPING_TIME_S,
        "load_inertia_kg_m2": BEHIND,
    }
    return Model(nominal).with_effect("coupling_compliance", **{**values, **changed})


def two_masses() -> np.ndarray:
    """d/dt of (theta, omega, z, phi, phi', r): the closed loop with both masses, linear."""
    k, rotor = 1.0 / COMPLIANCE, RIGID.inertia_kg_m2 - BEHIND
    twist = np.array([k, k * DAMPING_TIME_S, 0.0, -k, -k * DAMPING_TIME_S, 0.0])
    p, i = RIGID.proportional_gain_a_s_per_rad, RIGID.integral_gain_a_per_rad
    torque = RIGID.torque_constant_nm_per_a * np.array([0.0, -p, i, 0.0, 0.0, p])
    moved = np.zeros((6, 6))
    moved[0, 1] = moved[3, 4] = 1.0
    moved[1] = (torque - twist) / rotor
    moved[2, 1], moved[2, 5] = -1.0, 1.0
    moved[4] = twist / BEHIND
    return moved


def linear(levels: np.ndarray, oversampling: int = 1) -> np.ndarray:
    """States at every instant, shape (slots * oversampling + 1, 6), from rest."""
    step = expm(two_masses() * PERIOD_S / oversampling)
    x, states = np.zeros(6), []
    for level in np.repeat(levels, oversampling):
        x[5] = level
        states.append(x.copy())
        x = step @ x
    return np.array([*states, x])


def test_without_a_gap_it_is_the_linear_two_mass_system() -> None:
    states = linear(LEVELS)[:-1]

    def errors(longest_step_s: float) -> np.ndarray:
        model = Model(RIGID, coupled(RIGID).effects, longest_step_s)
        done = model.simulate(LEVELS, PERIOD_S)
        pairs = ((done.motor_angle_rad, 0), (done.load_angle_rad, 3))
        return np.array([np.abs(angle - states[:, k]).max() for angle, k in pairs])

    at_50, at_25 = errors(50e-6), errors(25e-6)
    assert (at_50 < SMALLEST_NAMED_RAD / 10.0).all(), at_50
    assert (np.log2(at_50 / at_25) > 1.8).all(), (at_50, at_25)


def test_the_gap_lies_behind_both_masses() -> None:
    """The load is the play of the second mass, at 512 instants in every slot."""
    half, load, loads = NOMINAL.backlash_gap_rad / 2.0, 0.0, []
    for k, angle in enumerate(linear(LEVELS, FINE)[:-1, 3]):
        load = min(max(load, angle - half), angle + half)
        if k % FINE == 0:
            loads.append(load)
    done = coupled(NOMINAL).simulate(LEVELS, PERIOD_S)
    np.testing.assert_allclose(done.load_angle_rad, loads, rtol=0, atol=SMALLEST_NAMED_RAD / 10.0)


def test_a_stiffer_coupling_comes_ever_nearer_to_none() -> None:
    plain = Model(NOMINAL).simulate(LEVELS, PERIOD_S).load_angle_rad
    off = [
        np.abs(
            coupled(NOMINAL, compliance_rad_per_nm=c).simulate(LEVELS, PERIOD_S).load_angle_rad
            - plain
        ).max()
        for c in (4e-3, 2e-3, 1e-3, 5e-4)
    ]
    assert (np.diff(off) < 0.0).all(), off
    assert off[-1] < 0.2 * off[0]


def test_a_motor_that_is_held_turns_the_load_at_the_antiresonance() -> None:
    """The transmission alone, under a motor that stops after a step: f = sqrt(k/J_c)/2 pi."""
    t_s = np.arange(2000) * 1e-4
    angle = 0.01 * np.clip(t_s / 1e-3, 0.0, 1.0)
    load = transmission(coupled(RIGID, damping_s=1e-6), np.full(t_s.size - 1, 1e-4), angle)
    rings = load[50:] - 0.01
    crossings = np.flatnonzero(np.diff(np.sign(rings)) > 0)
    between = crossings + rings[crossings] / (rings[crossings] - rings[crossings + 1])
    period_s = float(np.diff(between).mean()) * 1e-4
    assert 1.0 / period_s == pytest.approx(math.sqrt(1.0 / (COMPLIANCE * BEHIND)) / math.tau, 1e-3)


LOAD_INERTIA, LOAD_FRICTION = 5e-6, 2e-3


def three_bodies(_t: float, x: np.ndarray, r: float) -> np.ndarray:
    """d/dt of (theta, omega, z, phi, phi', y, y')."""
    theta, omega, z, phi, turned, load, rate = x
    twist = (theta - phi + DAMPING_TIME_S * (omega - turned)) / COMPLIANCE
    side = math.copysign(1.0, phi - load)
    pressed = side * (phi - load) - NOMINAL.backlash_gap_rad / 2.0
    force = pressed + FACE_DAMPING_S * side * (turned - rate) if pressed > 0.0 else 0.0
    contact = side * STIFFNESS * max(force, 0.0)
    current = NOMINAL.proportional_gain_a_s_per_rad * (r - omega)
    current += NOMINAL.integral_gain_a_per_rad * z
    torque = NOMINAL.torque_constant_nm_per_a * current
    rotor = NOMINAL.inertia_kg_m2 - BEHIND - LOAD_INERTIA
    held = LOAD_FRICTION * math.tanh(rate / 0.5)
    return np.array(
        [
            *(omega, (torque - twist) / rotor, r - omega),
            *(turned, (twist - contact) / BEHIND, rate, (contact - held) / LOAD_INERTIA),
        ]
    )


def test_with_soft_faces_it_is_three_bodies() -> None:
    levels, x, states = LEVELS[:8], np.zeros(7), []
    for level in levels:
        states.append(x)
        done = solve_ivp(
            *(three_bodies, (0.0, PERIOD_S), x, "DOP853"),
            args=(level,),
            rtol=1e-9,
            atol=1e-11,
            max_step=1e-4,
        )
        x = done.y[:, -1]
    reference = np.array(states)
    model = coupled(NOMINAL).with_effect("load_friction", torque_nm=LOAD_FRICTION)
    model = model.with_effect(
        "contact",
        compliance_rad_per_nm=1.0 / STIFFNESS,
        damping_s=FACE_DAMPING_S,
        load_inertia_kg_m2=LOAD_INERTIA,
    )

    def errors(longest_step_s: float) -> np.ndarray:
        found = Model(NOMINAL, model.effects, longest_step_s).simulate(levels, PERIOD_S)
        pairs = ((found.motor_angle_rad, 0), (found.true_load_angle_rad, 5))
        return np.array([np.abs(angle - reference[:, k]).max() for angle, k in pairs])

    # the last slot begins with a grazing impact: there the load is five times as far off
    at_50, at_6 = errors(50e-6), errors(6.25e-6)
    assert (at_50 < SMALLEST_NAMED_RAD / 4.0).all(), at_50
    assert (np.log2(at_50 / at_6) > 3 * 1.8).all(), (at_50, at_6)


def test_both_masses_are_parts_of_the_whole() -> None:
    with pytest.raises(EffectError, match=r"lower load_inertia_kg_m2"):
        coupled(NOMINAL, load_inertia_kg_m2=2.4e-4).with_effect(
            "contact", compliance_rad_per_nm=1e-3, load_inertia_kg_m2=2e-5
        )
