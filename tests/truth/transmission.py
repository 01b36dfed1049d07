"""From rotor to load: a coupling that may give way, a gap, a contact that never pulls.

    coupling  rotor and the gap's driver on a spring 1/compliance, lightly damped; else one body
    gap       b = (b0 + error) (1 + warming (1 - e^(-t/tau))) + swing cos(th_l - phi)
    contact   c = +-max(0, k p^1.5 (1 + chi dp/dt)),  p = |th - th_l - slip| - b/2 > 0
    screw     c over its limit slips the hub on its shaft, as far as brings c back to the limit
    load      J_l dw_l/dt  in  c - T_0 - T_g sin(th_l + phi) - F_l Sgn(w_l)

Hertz's contact with the damping of Hunt and Crossley (J. Appl. Mech. 42, 1975). Its force starts
with zero slope, so it needs no events; its damping is implicit in its own impulse.
"""

import math
from typing import NamedTuple

from tests.truth.compiling import law
from tests.truth.drive import Rig
from tests.truth.effects import Effects
from tests.truth.nuisances import Nuisances

COUPLING_DAMPING = 0.03
"""As a ratio to critical."""


class Driver(NamedTuple):
    """The body that carries the gap's flanks; moves with the rotor where nothing gives way."""

    rad: float
    rad_s: float


class Load(NamedTuple):
    """What is behind the gap; `slip_rad`: how far its hub has slipped."""

    rad: float
    rad_s: float
    slip_rad: float


class Shares(NamedTuple):
    """The inertia, divided: J nominal is the whole, with what hides in it."""

    rotor_kg_m2: float
    driver_kg_m2: float
    load_kg_m2: float


@law
def shares(rig: Rig, nuisances: Nuisances, effects: Effects) -> Shares:
    """Rotor, driver, load; the driver is the rotor where nothing gives way."""
    whole = rig.inertia_kg_m2 * (1.0 + effects.inertia_error) * (1.0 + nuisances.inertia_error)
    load = nuisances.load_inertia_kg_m2 + effects.load_inertia_kg_m2
    if effects.coupling_compliance_rad_per_nm > 0.0:
        driver = effects.coupling_share * (whole - load)
        return Shares(whole - load - driver, driver, load)
    return Shares(whole - load, whole - load, load)


@law
def half_gap_rad(effects: Effects, warm_rad: float, load_rad: float) -> float:
    """Half the gap here; `warm_rad`: the whole mean gap at this temperature."""
    if effects.backlash_swing_rad != 0.0:
        angle = load_rad - effects.backlash_swing_phase_rad
        warm_rad += effects.backlash_swing_rad * math.cos(angle)
    return max(0.0, 0.5 * warm_rad)


@law
def stiffness_nm_per_rad15(nuisances: Nuisances, effects: Effects) -> float:
    """Of the contact."""
    softness = effects.contact_softness_rad15_per_nm
    if softness == 0.0:
        return nuisances.contact_stiffness_nm_per_rad15
    return 1.0 / (1.0 / nuisances.contact_stiffness_nm_per_rad15 + softness)


@law
def pressed_nm(
    stiffness: float, damping: float, pressed: float, closing: float, give: float
) -> float:
    """Torque of a contact pressed by `pressed` > 0; `give`: velocity lost per torque, a step."""
    elastic = stiffness * pressed * math.sqrt(pressed)
    return max(0.0, elastic * (1.0 + damping * closing) / (1.0 + 0.5 * elastic * damping * give))


@law
def outside_nm(effects: Effects, load_rad: float) -> float:
    """What pulls at the load."""
    torque = -effects.load_torque_nm
    if effects.gravity_nm != 0.0:
        torque -= effects.gravity_nm * math.sin(load_rad + effects.gravity_phase_rad)
    return torque
