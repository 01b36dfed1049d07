"""What the axis holds: for the law that a coasting axis never gains any.

    E = sum J w^2 / 2 + (2/5) k p^2.5 + (rotor - driver)^2 / (2 compliance)
        - T_g cos(th_l + phi) + T_0 th_l

Springs of friction and the brake are not counted: they only ever take.
"""

import math

from tests.truth.drive import Rig
from tests.truth.effects import Effects
from tests.truth.nuisances import Nuisances
from tests.truth.state import State
from tests.truth.transmission import half_gap_rad, shares, stiffness_nm_per_rad15


def energy_j(rig: Rig, nuisances: Nuisances, effects: Effects, state: State) -> float:
    """Of the axis with its cold gap."""
    rotor, driver, load = state.rotor, state.driver, state.load
    parts = shares(rig, nuisances, effects)
    cold_rad = rig.backlash_gap_rad + effects.backlash_error_rad
    twist_rad = abs(driver.rad - load.rad - load.slip_rad)
    pressed_rad = max(0.0, twist_rad - half_gap_rad(effects, cold_rad, load.rad))
    energy = 0.5 * parts.rotor_kg_m2 * rotor.rad_s**2 + 0.5 * parts.load_kg_m2 * load.rad_s**2
    energy += 0.4 * stiffness_nm_per_rad15(nuisances, effects) * math.pow(pressed_rad, 2.5)
    if effects.coupling_compliance_rad_per_nm > 0.0:
        energy += 0.5 * parts.driver_kg_m2 * driver.rad_s**2
        energy += 0.5 * (rotor.rad - driver.rad) ** 2 / effects.coupling_compliance_rad_per_nm
    energy -= effects.gravity_nm * math.cos(load.rad + effects.gravity_phase_rad)
    return energy + effects.load_torque_nm * load.rad
