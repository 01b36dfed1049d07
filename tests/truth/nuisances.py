"""What is always there and what no effect describes: the difference between a rig and a model.

Sizes are below the smallest strength of every effect in `catalogue`; a seed scatters them.
"""

import math
from typing import NamedTuple

import numpy as np

SCATTER = 0.3
"""Relative, uniform, of every size that is drawn."""


class Nuisances(NamedTuple):
    """The axis beside its nominal values and its effects."""

    loop_period_s: float = 125e-6
    substeps: int = 5
    loop_phase: int = 0  # steps by which the drive's loop runs apart from the recorder's clock
    motor_counts_per_revolution: float = float(1 << 20)
    current_lag_s: float = 60e-6
    torque_noise_nm: float = 0.2e-3
    torque_constant_error: float = 0.0
    inertia_error: float = 0.0
    motor_friction_nm: float = 0.3e-3
    motor_viscous_nm_s_per_rad: float = 2e-5
    bearing_nm: float = 0.1e-3
    bearing_phase_rad: float = 0.0
    detent_nm: float = 0.1e-3
    detent_order: float = 24.0
    load_inertia_kg_m2: float = 3e-7
    load_friction_nm: float = 0.3e-3
    contact_stiffness_nm_per_rad15: float = 4000.0
    contact_damping_s_per_rad: float = 0.3
    start_in_gap: float = 0.0  # -1 .. 1 of the half gap: where the load is left

    @property
    def step_s(self) -> float:
        """The integrator's step."""
        return self.loop_period_s / self.substeps


QUIET = Nuisances(
    torque_noise_nm=0.0,
    motor_friction_nm=0.0,
    motor_viscous_nm_s_per_rad=0.0,
    bearing_nm=0.0,
    detent_nm=0.0,
    load_friction_nm=0.0,
)
"""Only what a finite drive and a finite contact need: for the laws of the effects."""


def scattered(seed: int) -> Nuisances:
    """A rig of its own: sizes +-30 %, K_T and J +-0.2 %, phases and the rest position anywhere."""
    rng = np.random.default_rng((seed, 0))
    mean = Nuisances()

    def around(size: float) -> float:
        return size * (1.0 + SCATTER * float(rng.uniform(-1.0, 1.0)))

    return mean._replace(
        loop_phase=int(rng.integers(mean.substeps)),
        current_lag_s=around(mean.current_lag_s),
        torque_noise_nm=around(mean.torque_noise_nm),
        torque_constant_error=0.002 * float(rng.uniform(-1.0, 1.0)),
        inertia_error=0.002 * float(rng.uniform(-1.0, 1.0)),
        motor_friction_nm=around(mean.motor_friction_nm),
        motor_viscous_nm_s_per_rad=around(mean.motor_viscous_nm_s_per_rad),
        bearing_nm=around(mean.bearing_nm),
        bearing_phase_rad=float(rng.uniform(0.0, math.tau)),
        detent_nm=around(mean.detent_nm),
        load_friction_nm=around(mean.load_friction_nm),
        contact_stiffness_nm_per_rad15=around(mean.contact_stiffness_nm_per_rad15),
        contact_damping_s_per_rad=around(mean.contact_damping_s_per_rad),
        start_in_gap=0.8 * float(rng.uniform(-1.0, 1.0)),
    )
