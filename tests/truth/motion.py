"""One step of all bodies: Moreau's time stepping (half drift, kick, half drift).

All bodies move by half a step; their velocities are kicked by what acts at the middle; set-valued
friction takes what it may; they move by the other half. The current's mean over a step is exact,
viscous damping acts on the mean of a step's two velocities.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tests.truth.compiling import law
from tests.truth.drive import dead_time
from tests.truth.effects import Effects
from tests.truth.mechanics import (
    DEFLECTIONS,
    Rotor,
    braked,
    driving_nm,
    friction_limits_nm,
    held,
    looked_up,
    stretched,
)
from tests.truth.nuisances import Nuisances
from tests.truth.state import Fixed, Warmth
from tests.truth.transmission import Driver, Load, half_gap_rad, outside_nm, pressed_nm


@law
def rotor_kicked(
    nuisances: Nuisances,
    effects: Effects,
    known: Fixed,
    warm: Warmth,
    rotor: Rotor,
    reference_a: float,
    outer_nm: float,
    h: float,
) -> tuple[Rotor, float, float]:
    """The rotor after every torque but friction's and the contact's; friction's limits, rad/s."""
    th, w = rotor.rad, rotor.rad_s
    per = h / known.shares.rotor_kg_m2
    added, followed = dead_time(effects, rotor.current_a, rotor.followed_v, h)
    target = reference_a + added
    ahead_of = rotor.current_a - target
    mean_a = target + known.lag_mean * ahead_of
    torque = driving_nm(effects, warm.torque_constant_nm_per_a, mean_a, th, w)
    forwards, backwards = friction_limits_nm(nuisances, effects, warm.coulomb_nm, th, w, torque)
    drag = nuisances.motor_viscous_nm_s_per_rad + effects.viscous_nm_s_per_rad
    torque += outer_nm
    s1, s2, s3, s4 = rotor.spring_1_nm, rotor.spring_2_nm, rotor.spring_3_nm, rotor.spring_4_nm
    if effects.presliding_rad > 0.0:
        moved, slips = h * w, effects.presliding_rad
        ahead, behind = 0.25 * forwards, 0.25 * backwards
        s1 = stretched(s1, moved, slips * DEFLECTIONS[0], ahead, behind)
        s2 = stretched(s2, moved, slips * DEFLECTIONS[1], ahead, behind)
        s3 = stretched(s3, moved, slips * DEFLECTIONS[2], ahead, behind)
        s4 = stretched(s4, moved, slips * DEFLECTIONS[3], ahead, behind)
        hangs = 1.0 if -behind < s4 < ahead else 0.0
        torque -= s1 + s2 + s3 + s4 + hangs * known.micro_nm_s_per_rad * w
        forwards, backwards = 0.0, 0.0
    brake = rotor.brake_nm
    if effects.hysteresis_brake_nm > 0.0:
        brake = braked(effects, brake, h * w)
        torque -= brake
    torque = (torque - drag * w) / (1.0 + 0.5 * per * drag)
    current = target + known.lag_decay * ahead_of
    kicked = Rotor(th, w + per * torque, current, followed, s1, s2, s3, s4, brake)
    return kicked, per * forwards, per * backwards


@law
def coupled(known: Fixed, rotor: Driver, driver: Driver, h: float) -> tuple[float, float]:
    """Velocities of rotor and driver after the spring between them."""
    if known.spring_nm_per_rad == 0.0:
        return rotor.rad_s, rotor.rad_s
    torque = known.spring_nm_per_rad * (rotor.rad - driver.rad)
    torque += known.spring_nm_s_per_rad * (rotor.rad_s - driver.rad_s)
    per_rotor, per_driver = h / known.shares.rotor_kg_m2, h / known.shares.driver_kg_m2
    torque /= 1.0 + 0.5 * known.spring_nm_s_per_rad * (per_rotor + per_driver)
    return rotor.rad_s - per_rotor * torque, driver.rad_s + per_driver * torque


@law
def touched(
    effects: Effects,
    known: Fixed,
    warm: Warmth,
    driver: Driver,
    load: Load,
    closed_before: float,
    h: float,
) -> tuple[float, float, float]:
    """Velocities of driver and load, and slip, after the contact.

    `closed_before`: the driver's velocity ahead of the load's before this step's other kicks. The
    damping takes the mean of the step's begin and end, or a resting load would seem to move.
    """
    w, w_load, slip = driver.rad_s, load.rad_s, load.slip_rad
    half_gap = half_gap_rad(effects, warm.gap_rad, load.rad)
    twist = driver.rad - load.rad - slip
    if -half_gap <= twist <= half_gap:
        return w, w_load, slip
    side = 1.0 if twist > 0.0 else -1.0
    per_driver, per_load = h / known.shares.driver_kg_m2, h / known.shares.load_kg_m2
    pressed = side * twist - half_gap
    closing = 0.5 * side * (closed_before + w - w_load)
    stiffness = known.stiffness_nm_per_rad15
    torque = pressed_nm(stiffness, known.damping_s_per_rad, pressed, closing, per_driver + per_load)
    if effects.slip_per_nm > 0.0 and torque > 1.0 / effects.slip_per_nm:
        torque = 1.0 / effects.slip_per_nm
        left = math.exp(math.log(torque / stiffness) * (2.0 / 3.0))
        slip += side * max(0.0, pressed - left)
    return w - per_driver * side * torque, w_load + per_load * side * torque, slip


@law
def stepped(
    nuisances: Nuisances,
    effects: Effects,
    known: Fixed,
    warm: Warmth,
    table: NDArray[np.float64],
    rotor: Rotor,
    driver: Driver,
    load: Load,
    reference_a: float,
    noise_nm: float,
    h: float,
) -> tuple[Rotor, Driver, Load]:
    """All bodies after a step of h."""
    half = 0.5 * h
    th = rotor.rad + half * rotor.rad_s
    th_driver = driver.rad + half * driver.rad_s
    th_load = load.rad + half * load.rad_s
    middle = Rotor(
        th,
        rotor.rad_s,
        rotor.current_a,
        rotor.followed_v,
        rotor.spring_1_nm,
        rotor.spring_2_nm,
        rotor.spring_3_nm,
        rotor.spring_4_nm,
        rotor.brake_nm,
    )
    outer_nm = noise_nm + looked_up(table, th)
    r, forwards, backwards = rotor_kicked(
        nuisances, effects, known, warm, middle, reference_a, outer_nm, h
    )
    per_load = h / known.shares.load_kg_m2
    w_load = load.rad_s + per_load * outside_nm(effects, th_load)
    w, w_driver = coupled(known, Driver(th, r.rad_s), Driver(th_driver, driver.rad_s), h)
    w_driver, w_load, slip = touched(
        effects,
        known,
        warm,
        Driver(th_driver, w_driver),
        Load(th_load, w_load, load.slip_rad),
        driver.rad_s - load.rad_s,
        h,
    )
    stops = per_load * (nuisances.load_friction_nm + effects.load_friction_nm)
    w_load = held(w_load, stops, stops)
    if known.spring_nm_per_rad == 0.0:
        w_driver = held(w_driver, forwards, backwards)
        w = w_driver
    else:
        w = held(w, forwards, backwards)
    moved = Rotor(
        th + half * w,
        w,
        r.current_a,
        r.followed_v,
        r.spring_1_nm,
        r.spring_2_nm,
        r.spring_3_nm,
        r.spring_4_nm,
        r.brake_nm,
    )
    return (
        moved,
        Driver(th_driver + half * w_driver, w_driver),
        Load(th_load + half * w_load, w_load, slip),
    )
