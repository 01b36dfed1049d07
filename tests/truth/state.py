"""What the axis is: its state, and what stays of it through a run or through a loop period."""

import math
from typing import NamedTuple

from tests.truth.compiling import law
from tests.truth.drive import AT_REST, Drive, Rig
from tests.truth.effects import Effects
from tests.truth.mechanics import MICRO_DAMPING, Rotor
from tests.truth.nuisances import Nuisances
from tests.truth.transmission import (
    COUPLING_DAMPING,
    Driver,
    Load,
    Shares,
    shares,
    stiffness_nm_per_rad15,
)


class State(NamedTuple):
    """The whole axis at the end of a step."""

    step: int
    noise_nm: float
    creep_rad: float
    drive: Drive
    rotor: Rotor
    driver: Driver
    load: Load


class Warmth(NamedTuple):
    """What drifts with temperature, at a time."""

    torque_constant_nm_per_a: float
    coulomb_nm: float
    gap_rad: float


class Fixed(NamedTuple):
    """What stays through a run."""

    shares: Shares
    stiffness_nm_per_rad15: float
    damping_s_per_rad: float
    spring_nm_per_rad: float
    spring_nm_s_per_rad: float
    lag_decay: float
    lag_mean: float
    micro_nm_s_per_rad: float


def at_rest(rig: Rig, nuisances: Nuisances) -> State:
    """Nothing moves, the rotor at zero, the load where it was left in the gap."""
    load_rad = nuisances.start_in_gap * 0.5 * rig.backlash_gap_rad
    rotor = Rotor(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    driver, load = Driver(0.0, 0.0), Load(load_rad, 0.0, 0.0)
    return State(0, 0.0, 0.0, AT_REST, rotor, driver, load)


@law
def warmth(rig: Rig, nuisances: Nuisances, effects: Effects, t: float) -> Warmth:
    """At time t since the start."""
    torque_constant = rig.torque_constant_nm_per_a * (1.0 + nuisances.torque_constant_error)
    torque_constant *= 1.0 + effects.torque_constant_error
    if effects.torque_constant_drift != 0.0:
        warm = 1.0 - math.exp(-t / effects.torque_constant_drift_s)
        torque_constant *= 1.0 - effects.torque_constant_drift * warm
    coulomb = effects.coulomb_nm
    if effects.friction_drift != 0.0:
        coulomb *= 1.0 + effects.friction_drift * math.exp(-t / effects.friction_drift_s)
    gap = rig.backlash_gap_rad + effects.backlash_error_rad
    if effects.backlash_warming != 0.0:
        gap *= 1.0 + effects.backlash_warming * (1.0 - math.exp(-t / effects.backlash_warming_s))
    return Warmth(torque_constant, coulomb, gap)


@law
def fixed(rig: Rig, nuisances: Nuisances, effects: Effects, h: float) -> Fixed:
    """Of this axis at this step."""
    parts = shares(rig, nuisances, effects)
    spring, spring_damping = 0.0, 0.0
    if effects.coupling_compliance_rad_per_nm > 0.0:
        spring = 1.0 / effects.coupling_compliance_rad_per_nm
        both = parts.rotor_kg_m2 + parts.driver_kg_m2
        reduced = parts.rotor_kg_m2 * parts.driver_kg_m2 / both
        spring_damping = 2.0 * COUPLING_DAMPING * math.sqrt(spring * reduced)
    micro = 0.0
    if effects.presliding_rad > 0.0:
        stiffness = (nuisances.motor_friction_nm + effects.coulomb_nm) / effects.presliding_rad
        micro = 2.0 * MICRO_DAMPING * math.sqrt(stiffness * parts.rotor_kg_m2)
    lag = nuisances.current_lag_s + effects.current_lag_s
    decay = math.exp(-h / lag)
    return Fixed(
        parts,
        stiffness_nm_per_rad15(nuisances, effects),
        nuisances.contact_damping_s_per_rad + effects.contact_damping_s_per_rad,
        spring,
        spring_damping,
        decay,
        (1.0 - decay) * lag / h,
        micro,
    )
