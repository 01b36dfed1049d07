"""The rotor: what turns it, and what holds it.

    driving   K_T(i, t) i (1 + ripple cos(n th + phi)) + table(th) + gear mesh + noise
              K_T = K_T0 (1 + error) (1 - drift (1 - e^(-t/tau))) / (1 + droop i^2)
    braking   B w + c w |w|, hysteresis brake, and the set-valued friction F Sgn(w)
    F         limit + asymmetry forwards, limit - asymmetry backwards
    limit     F0 + F_C (1 + drift e^(-t/tau)) + F_S e^(-(w/v_S)^2) + F_1 cos(th - phi) + mu |T|

Cogging is a table over one turn, linear between its entries. Without pre-sliding, friction is a
projection: it takes up to F and holds a rotor that rests. With it, four springs that slip, each at
its own deflection (the element of Jenkin and Iwan), bear a quarter of F each: a rotor that rests
gives way, with a hysteresis that has memory. A hysteresis brake is one spring that yields over a
wide angle, dT/dth = (T_m - T sgn w) / th_c.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.truth.compiling import law
from tests.truth.effects import Effects
from tests.truth.nuisances import Nuisances

TABLE_SIZE = 4096
DEFLECTIONS = (0.4, 0.8, 1.2, 1.6)
"""At which the four springs slip, as multiples of the break-away deflection; their mean is 1."""

MICRO_DAMPING = 0.1
"""Of a rotor that hangs in its springs, as a ratio to critical."""


class Rotor(NamedTuple):
    """Its motion, and what its friction remembers."""

    rad: float
    rad_s: float
    current_a: float
    followed_v: float
    spring_1_nm: float
    spring_2_nm: float
    spring_3_nm: float
    spring_4_nm: float
    brake_nm: float


def torque_table_nm(nuisances: Nuisances, effects: Effects) -> NDArray[np.float64]:
    """Torque over one turn of the rotor, shape (TABLE_SIZE + 1,), the last entry the first."""
    th = np.arange(TABLE_SIZE) * (math.tau / TABLE_SIZE)
    table = nuisances.bearing_nm * np.sin(th + nuisances.bearing_phase_rad)
    table += nuisances.detent_nm * np.sin(nuisances.detent_order * th)
    if effects.cogging_nm != 0.0:
        table += effects.cogging_nm * np.cos(effects.cogging_order * th + effects.cogging_phase_rad)
    return np.append(table, table[0])


@law
def looked_up(table: NDArray[np.float64], th: float) -> float:
    """The table at an angle."""
    place = th * (TABLE_SIZE / math.tau)
    whole = math.floor(place)
    entry = int(whole) % TABLE_SIZE
    below, above = float(table[entry]), float(table[entry + 1])
    return below + (place - whole) * (above - below)


@law
def driving_nm(
    effects: Effects, torque_constant: float, current: float, th: float, w: float
) -> float:
    """Torque of the current, the gear mesh, and the air; `torque_constant` at this temperature."""
    torque = torque_constant * current
    if effects.torque_constant_droop_per_a2 > 0.0:
        torque /= 1.0 + effects.torque_constant_droop_per_a2 * current * current
    if effects.torque_ripple != 0.0:
        angle = effects.torque_ripple_order * th + effects.torque_ripple_phase_rad
        torque *= 1.0 + effects.torque_ripple * math.cos(angle)
    if effects.gear_mesh_nm != 0.0:
        torque += effects.gear_mesh_nm * math.sin(effects.gear_mesh_order * th)
    return torque - effects.air_drag_nm_s2_per_rad2 * w * abs(w)


@law
def friction_limits_nm(
    nuisances: Nuisances, effects: Effects, coulomb: float, th: float, w: float, torque: float
) -> tuple[float, float]:
    """The most that friction takes forwards and backwards; `coulomb` at this temperature."""
    limit = nuisances.motor_friction_nm + coulomb
    if effects.stribeck_nm != 0.0:
        ratio = w / effects.stribeck_velocity_rad_s
        limit += effects.stribeck_nm * math.exp(-ratio * ratio)
    if effects.friction_swing_nm != 0.0:
        limit += effects.friction_swing_nm * math.cos(th - effects.friction_swing_phase_rad)
    limit += effects.friction_load_share * abs(torque)
    asymmetry = effects.friction_asymmetry_nm
    return max(0.0, limit + asymmetry), max(0.0, limit - asymmetry)


@law
def held(w: float, forwards: float, backwards: float) -> float:
    """Velocity after set-valued friction, which can take `forwards` or `backwards` of it."""
    if w > forwards:
        return w - forwards
    if w < -backwards:
        return w + backwards
    return 0.0


@law
def stretched(spring: float, moved: float, slips: float, ahead: float, behind: float) -> float:
    """A spring that slips: its torque after its end moved; `slips`: deflection of doing so."""
    spring += 0.5 * (ahead + behind) * moved / slips
    return min(max(spring, -behind), ahead)


@law
def braked(effects: Effects, brake: float, moved: float) -> float:
    """The hysteresis brake's torque after the rotor moved."""
    share = 1.0 - math.exp(-abs(moved) / effects.hysteresis_brake_rad)
    return brake + share * (math.copysign(effects.hysteresis_brake_nm, moved) - brake)
