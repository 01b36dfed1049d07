"""The plant on a test's table: quiet, with one thing wrong, and looked at closely."""

import math

import numpy as np
from numpy.typing import NDArray

from tests.truth.effects import NONE
from tests.truth.nuisances import QUIET
from tests.truth.plant import NominalValues, TruthPlant
from tests.truth.rigs import PAPER

K_T, J = PAPER.torque_constant_nm_per_a, PAPER.inertia_kg_m2
LOOP_S = QUIET.loop_period_s
VELOCITY_RAD_S = math.radians(150.0)
PERIOD_S = 0.008


def quiet(**strengths: float) -> TruthPlant:
    """The paper's rig without friction and noise, with these effects."""
    return quiet_on(PAPER, **strengths)


def quiet_on(nominal: NominalValues, **strengths: float) -> TruthPlant:
    """The same on another rig."""
    return TruthPlant(nominal, 1, NONE._replace(**strengths), QUIET)


def random_commands(slots: int, seed: int = 0) -> NDArray[np.float64]:
    """Signs at random, at the paper's speed, shape (slots,)."""
    bits = np.random.default_rng(seed).integers(0, 2, slots)
    signs: NDArray[np.float64] = 1.0 - 2.0 * bits.astype(np.float64)
    return VELOCITY_RAD_S * signs


def steady_current_a(plant: TruthPlant, velocity_rad_s: float, settle_s: float = 1.5) -> float:
    """The mean current over 0.25 s, after the loop has settled at a velocity."""
    plant.advance(velocity_rad_s, settle_s)
    held = np.full(2000, velocity_rad_s)
    return float(plant.play(held, LOOP_S).motor_current_a.mean())


def harmonic(
    angle_rad: NDArray[np.float64], values: NDArray[np.float64], order: float
) -> tuple[float, float]:
    """Amplitudes of cos and sin of `order` times the angle, beside a constant (least squares)."""
    columns = [np.ones_like(angle_rad), np.cos(order * angle_rad), np.sin(order * angle_rad)]
    found = np.linalg.lstsq(np.stack(columns, axis=1), values, rcond=None)[0]
    return float(found[1]), float(found[2])
