"""Nominal rigs: the paper's, and others like it. What a diagnosis may see."""

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class NominalRig:
    """Nominal values, by the names that a rig's settings have."""

    torque_constant_nm_per_a: float
    inertia_kg_m2: float
    proportional_gain_a_s_per_rad: float
    integral_gain_a_per_rad: float
    backlash_gap_rad: float


def tuned(
    natural_frequency_rad_s: float,
    damping_ratio: float,
    torque_constant_nm_per_a: float,
    inertia_kg_m2: float,
    backlash_gap_rad: float,
) -> NominalRig:
    """A drive tuned to wn and zeta: K_P = 2 zeta wn J/K_T, K_I = wn^2 J/K_T."""
    per_gain = inertia_kg_m2 / torque_constant_nm_per_a
    return NominalRig(
        torque_constant_nm_per_a,
        inertia_kg_m2,
        2.0 * damping_ratio * natural_frequency_rad_s * per_gain,
        natural_frequency_rad_s**2 * per_gain,
        backlash_gap_rad,
    )


PAPER = tuned(62.5, 0.4, 0.03606, 0.00025, math.radians(1.5))


def drawn_widely(seed: int) -> NominalRig:
    """wn 30..150 rad/s, zeta 0.3..1, K_T 0.02..0.5 N m/A, J 5e-5..2e-3, gap 0.2, 1.5, or 3 deg."""
    rng = np.random.default_rng((seed, 8))

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    return tuned(
        natural_frequency_rad_s=between(30.0, 150.0),
        damping_ratio=float(rng.uniform(0.3, 1.0)),
        torque_constant_nm_per_a=between(0.02, 0.5),
        inertia_kg_m2=between(5e-5, 2e-3),
        backlash_gap_rad=math.radians(float(rng.choice((0.2, 1.5, 3.0)))),
    )


def drawn(seed: int) -> NominalRig:
    """wn 62.5..100 rad/s, zeta 0.4..0.8, K_T 0.03..0.08 N m/A, J 1e-4..5e-4, gap 0.5..2 deg."""
    rng = np.random.default_rng((seed, 7))
    return tuned(
        natural_frequency_rad_s=float(rng.uniform(62.5, 100.0)),
        damping_ratio=float(rng.uniform(0.4, 0.8)),
        torque_constant_nm_per_a=float(rng.uniform(0.03, 0.08)),
        inertia_kg_m2=float(np.exp(rng.uniform(math.log(1e-4), math.log(5e-4)))),
        backlash_gap_rad=math.radians(float(rng.uniform(0.5, 2.0))),
    )
