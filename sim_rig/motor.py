"""The paper's servo motor: a PI velocity loop around an inertia, solved exactly.

    J  d(omega)/dt = K_T i,      d(theta)/dt = omega,      dz/dt = r - omega
    i = K_P (r - omega) + K_I z

    omega(s) / r(s) = G(s) = (2 zeta wn s + wn^2) / (s^2 + 2 zeta wn s + wn^2)

Symbols: r velocity command, omega motor velocity, theta motor angle, z integral of the velocity
error, i motor current. Between two commands r is constant, so a step of any length has a matrix
(zero-order hold); no integrator, no step error. Time is whole microseconds: a duration is played
as a row of steps of 2**k us, so the same durations give the same bits on every machine.
"""

from functools import lru_cache
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from sim_rig.settings import Nominal

LONGEST_STEP_US = 512
"""The longest step between two looks at the play; it must see the motor turn around."""


class MotorState(NamedTuple):
    """Angle, velocity, and the integral of the velocity error (rad, rad/s, rad)."""

    angle_rad: float = 0.0
    velocity_rad_s: float = 0.0
    velocity_error_integral_rad: float = 0.0


class Step(NamedTuple):
    """x(t + h) = phi x(t) + gamma r, for x = (theta, omega, z): shapes (3, 3) and (3,)."""

    phi: NDArray[np.float64]
    gamma: NDArray[np.float64]

    def then(self, after: "Step") -> "Step":
        """This step and then another, under one command."""
        return Step(after.phi @ self.phi, after.phi @ self.gamma + after.gamma)


def state_space(nominal: Nominal) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A, shape (3, 3), and B, shape (3,), of dx/dt = A x + B r for x = (theta, omega, z)."""
    per_amp = nominal.torque_constant_nm_per_a / nominal.inertia_kg_m2
    k_p = nominal.proportional_gain_a_s_per_rad * per_amp
    k_i = nominal.integral_gain_a_per_rad * per_amp
    a = np.array([[0.0, 1.0, 0.0], [0.0, -k_p, k_i], [0.0, -1.0, 0.0]])
    return a, np.array([0.0, k_p, 1.0])


def exact_step(nominal: Nominal, duration_s: float) -> Step:
    """The zero-order hold over `duration_s`, from one matrix exponential."""
    a, b = state_space(nominal)
    augmented = np.zeros((4, 4))
    augmented[:3, :3], augmented[:3, 3] = a, b
    exponential = expm(augmented * duration_s)
    return Step(exponential[:3, :3], exponential[:3, 3])


@lru_cache(maxsize=16)
def doubling_steps(nominal: Nominal) -> dict[int, Step]:
    """The steps of 1, 2, 4, ... LONGEST_STEP_US microseconds, by their length."""
    lengths = [1 << k for k in range(LONGEST_STEP_US.bit_length())]
    return {length: exact_step(nominal, length * 1e-6) for length in lengths}


@lru_cache(maxsize=4096)
def step_lengths_us(duration_us: int) -> tuple[int, ...]:
    """How a duration is played: as many longest steps as fit, then the rest by its bits."""
    whole, rest = divmod(duration_us, LONGEST_STEP_US)
    bits = [1 << k for k in reversed(range(LONGEST_STEP_US.bit_length() - 1))]
    return (LONGEST_STEP_US,) * whole + tuple(bit for bit in bits if rest & bit)


Value = TypeVar("Value", float, NDArray[np.float64])


def motor_current_a(
    nominal: Nominal,
    velocity_command_rad_s: Value,
    velocity_rad_s: Value,
    velocity_error_integral_rad: Value,
) -> Value:
    """i = K_P (r - omega) + K_I z, for floats or for arrays of one shape."""
    return (
        nominal.proportional_gain_a_s_per_rad * (velocity_command_rad_s - velocity_rad_s)
        + nominal.integral_gain_a_per_rad * velocity_error_integral_rad
    )
