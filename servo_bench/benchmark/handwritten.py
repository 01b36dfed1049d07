"""Eighteen effects in one function written by hand: what the generated page is measured against.

The same equations and the same stepping as `sim_rig.model` with `EFFECTS`, and nothing that is
not needed for them: no other effect, no other mode, one slot length, one delay shorter than it.
"""

from collections.abc import Callable
from math import ceil, copysign, exp, floor, sin
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_rig.model.contact import left_at, meet, oscillate, piece_of, sprung, swung, twisted, upward
from sim_rig.model.lesser import greater, lesser
from sim_rig.model.propagator import propagator
from sim_rig.model.saturated import saturated
from sim_rig.model.skeleton import FINER, IMPACT_S

Array = NDArray[np.float64]

HELPERS = (
    *(lesser, greater, saturated, propagator, sprung, swung, oscillate, twisted, upward),
    *(left_at, piece_of, meet),
)

EFFECTS: dict[str, dict[str, float]] = {
    "coulomb": {"torque_nm": 0.008},
    "viscous": {"damping_nm_s_per_rad": 2e-4},
    "stribeck": {"excess_torque_nm": 0.002},
    "pre_sliding": {"torque_nm": 0.002},
    "cogging": {"torque_nm": 0.004, "order": 24.0, "phase_rad": 0.3},
    "current_limit": {"limit_per_a": 1.0 / 9.0},
    "current_loop_lag": {"lag_s": 3e-4},
    "transport_delay": {"delay_s": 2.5e-3},
    "torque_constant_error": {"error_fraction": 0.03},
    "inertia_error": {"error_fraction": 0.05},
    "backlash_width": {"change_rad": 0.002},
    "gravity_imbalance": {"torque_nm": 0.004, "phase_rad": 0.5},
    "load_friction": {"torque_nm": 0.003},
    "encoder_eccentricity": {"amplitude_rad": 5e-4, "phase_rad": 1.0},
    "integrator_clamp": {"clamp_per_a": 1.0 / 3.0},
    "clock_skew": {"skew_fraction": 2e-5},
    "missed_samples": {"miss_probability": 1e-3},
    "contact": {"compliance_rad_per_nm": 2e-3, "damping_s": 4e-4, "load_inertia_kg_m2": 5e-6},
}


class Symbols(NamedTuple):
    """Everything that stands in the equations, nominal values first."""

    k_t: float
    j: float
    k_p: float
    k_i: float
    gap: float
    coulomb: float = 0.008
    transition: float = 0.5
    viscous: float = 2e-4
    stribeck: float = 0.002
    stribeck_rad_s: float = 1.0
    stribeck_transition: float = 0.2
    dahl: float = 0.002
    dahl_rad: float = 3e-4
    cogging: float = 0.004
    order: float = 24.0
    phase: float = 0.3
    limit: float = 9.0
    lag: float = 3e-4
    delay: float = 2.5e-3
    k_t_error: float = 0.03
    j_error: float = 0.05
    gap_change: float = 0.002
    gravity: float = 0.004
    gravity_phase: float = 0.5
    load_friction: float = 0.003
    load_transition: float = 0.5
    eccentricity: float = 5e-4
    eccentricity_phase: float = 1.0
    clamp: float = 3.0
    skew: float = 2e-5
    missed: float = 1e-3
    stiffness: float = 500.0
    damping_s: float = 4e-4
    j_load: float = 5e-6


def eighteen(  # noqa: PLR0912, PLR0915 - one loop, by hand
    s: Symbols, commands: Array, period_s: float, longest_step_s: float, loads: Array
) -> None:
    """The recorded load angle, rad, at every slot's end."""
    theta, omega, z, load, rate = 0.0, 0.0, 0.0, 0.0, 0.0
    bend, current, edge, seen, held, drive = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    powered = False
    per_a = s.k_t / s.j
    per_motor = 1.0 / (s.j * (1.0 + s.j_error) - s.j_load)
    per_load = 1.0 / s.j_load
    per_mass = per_load + per_motor
    moved = 1.0 / per_mass
    decay, square, soft = sprung(per_mass, s.stiffness, s.damping_s)
    gap = max(s.gap + s.gap_change, 0.0)
    clamp = s.clamp / s.k_i
    deviation, apart, q, driven, jerk, change, cut_before = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(commands.size):
        draw = 43758.5453 * sin(12.9898 * k + 1.0)
        held = held if draw - floor(draw) < s.missed else commands[k]
        delay = s.delay + s.skew * k * period_s
        for piece in range(2):
            length = delay if piece == 0 else period_s - delay
            if piece == 1:
                drive, powered = held, True
            steps = ceil(length / longest_step_s - 1e-9)
            k_p, k_i = (s.k_p, s.k_i) if powered else (0.0, 0.0)
            part, whole, fine, before, soon = 0, steps, 0, 0.0, False
            while part == 0 or whole > 0 or fine > 0:
                if part == 1 and soon and fine == 0:
                    least = ceil(IMPACT_S * steps / length - 1e-9)
                    least = least if least < whole else whole
                    whole, fine = whole - least, least * FINER
                h = 0.0 if part == 0 else length / steps if fine == 0 else length / steps / FINER
                since = 0.5 * (before + h)
                per_since = 1.0 / since if since > 0.0 else 0.0
                per_step = 1.0 / h if h > 0.0 else 0.0
                count = 1 if part == 0 or before != h else whole if fine == 0 else fine
                half, lead, cube = 0.5 * h, 0.5 * before + 0.25 * h, h * h * h / 12.0
                before = h
                a11, a12, a21, a22, b11, b12, b21, b22, c11, c12 = propagator(
                    per_a * k_p, per_a * k_i, half
                )
                e11, e12, e21, e22, s11, s12, s21, s22, d11, d12 = propagator(
                    per_a * k_p, per_a * k_i, h
                )
                bent, pressed = piece_of(soft, half), piece_of(soft, h)
                bent_c, bent_s = swung(decay, square, bent)
                pressed_c, pressed_s = swung(decay, square, pressed)
                left = exp(-h / s.lag)
                mean = (1.0 - left) / (h / s.lag) if h > 0.0 else 1.0
                done = 0
                while done < count:
                    done += 1
                    error = omega - drive
                    pulled, lately = deviation + lead * jerk, q + lead * change
                    angle = theta + (drive * half + b11 * error + b12 * z)
                    angle += c11 * pulled + c12 * lately
                    velocity = drive + (a11 * error + a12 * z) + (b11 * pulled + b12 * lately)
                    integral = (a21 * error + a22 * z) + (b21 * pulled + b22 * lately)
                    load_angle, load_velocity = load, rate
                    x, v = theta - load, omega - rate
                    if h > 0.0:
                        x_mid, v_mid = meet(
                            *(x, v, apart, s.damping_s, 0.0, decay, square, soft, gap, half),
                            *(bent, bent_c, bent_s),
                        )
                        share = per_motor * moved
                        moment = x + (v + 0.5 * apart * half) * half - x_mid
                        angle -= share * moment
                        integral += share * moment
                        velocity -= share * (v + apart * half - v_mid)
                        load_angle, load_velocity = angle - x_mid, velocity - v_mid
                    ideal = k_p * (drive - velocity) + k_i * integral
                    integral = min(max(integral, -clamp), clamp)
                    asked = s.k_p * (drive - velocity) + s.k_i * integral if powered else 0.0
                    cut = asked
                    asked = min(max(asked, -s.limit), s.limit)
                    cut -= asked
                    slope = (asked - seen) * per_since
                    end = asked + half * slope
                    made = current
                    if h > 0.0:
                        behind = (end - edge) * (1.0 - mean) * s.lag / h
                        made = edge + 0.5 * (end - edge) + (current - edge) * mean - behind
                        behind = (end - edge) * (1.0 - left) * s.lag / h
                        current = end + (current - edge) * left - behind
                    edge, seen = end, asked
                    torque = s.k_t * made * (1.0 + s.k_t_error)
                    jerk = -driven
                    driven = torque * per_motor - per_a * ideal
                    jerk = (jerk + driven) * per_since
                    torque += s.cogging * sin(s.order * angle + s.phase)
                    torque -= s.coulomb * saturated(velocity / s.transition)
                    travel = velocity * h / s.dahl_rad
                    side = copysign(1.0, travel) if travel != 0.0 else 0.0
                    torque -= s.dahl * (side + (bend - side) * exp(-0.5 * abs(travel)))
                    bend = side + (bend - side) * exp(-abs(travel))
                    slow = exp(-((abs(velocity) / s.stribeck_rad_s) ** 2.0))
                    torque -= s.stribeck * slow * saturated(velocity / s.stribeck_transition)
                    torque -= s.viscous * velocity
                    on_load = -s.gravity * sin(load_angle + s.gravity_phase)
                    on_load -= s.load_friction * saturated(load_velocity / s.load_transition)
                    deviation = torque * per_motor - per_a * ideal
                    apart = torque * per_motor - on_load * per_load
                    change = -q
                    q = velocity - drive + (drive - velocity)
                    change = (change + q) * per_since
                    if h > 0.0:
                        x_end, v_end = meet(
                            *(x, v, apart, s.damping_s, 0.0, decay, square, soft, gap, h),
                            *(pressed, pressed_c, pressed_s),
                        )
                        impulse = (v + apart * h - v_end) * moved
                        moment = (x + (v + apart * half) * h - x_end) * moved
                        contact, late = impulse * per_step, moment - impulse * half
                        pull = deviation - contact * per_motor
                        theta += drive * h + s11 * error + s12 * z + d11 * pull + d12 * q
                        omega = drive + (e11 * error + e12 * z) + (s11 * pull + s12 * q)
                        z = e21 * error + e22 * z + s21 * pull + s22 * q
                        lag = late * per_motor + jerk * cube
                        theta -= lag
                        omega += per_a * (k_p * lag - k_i * change * cube)
                        z += lag
                        z = min(max(z, -clamp), clamp) if powered else 0.0
                        pushed = (contact + on_load) * per_load
                        load += (rate + pushed * half) * h + late * per_load
                        rate += pushed * h
                    closing = omega - rate
                    ahead = theta - load if closing > 0.0 else load - theta
                    soon = 0.0 < 0.5 * gap - ahead < 1.5 * abs(closing) * length / steps
                    if cut != 0.0 and since > 0.0:
                        ahead = cut * since + 2.0 * (cut - cut_before) * length / steps
                        soon = soon or cut * ahead < 0.0
                    cut_before = cut
                    if soon and fine == 0:
                        break
                if part == 0:
                    part = 1
                elif fine == 0:
                    whole -= done
                else:
                    fine -= done
        loads[k] = load + s.eccentricity * sin(load + s.eccentricity_phase)


def compiled() -> Callable[..., None]:
    """`eighteen`, compiled as numba compiles a function, with no cache."""
    from numba import njit  # noqa: PLC0415 - only a measurement needs it

    options: Any = {"nogil": True, "error_model": "numpy"}
    names: dict[str, Any] = {}
    for function in HELPERS:
        names[function.__name__] = njit(**options)(_with(function, names))
    run: Callable[..., None] = njit(**options)(_with(eighteen, names))
    return run


def _with(function: Any, names: dict[str, Any]) -> Any:
    """The function with other globals under some names."""
    return type(function)(function.__code__, {**function.__globals__, **names}, function.__name__)
