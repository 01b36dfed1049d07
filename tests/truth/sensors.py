"""The load encoder: what it reports of the load angle, at once and without dynamics.

creep            the bracket of its head yields to the motor's torque, and slowly
vibration        A sin(2 pi f t): the floor
eccentricity     (e/R) sin(th + phi)
misalignment     atan(tan th / cos beta) - th, of a shaft at an angle (2 per revolution)
subdivision      A sin(N th), N lines
quantum          floor to whole quanta
bit errors       bursts in which one bit of the word is wrong: 24 ms from each start
"""

import math

import numpy as np
from numpy.typing import NDArray

from tests.truth.effects import Effects

BURST_S = 0.024
HORIZON_S = 1200.0
"""Bit errors are drawn up to here."""

WORD_RAD = math.tau / 65536
LOWEST_BIT, HIGHEST_BIT = 5, 10


class BitErrors:
    """When a bit of the encoder's word is wrong, and by how much; a Poisson process."""

    def __init__(self, per_s: float, rng: np.random.Generator) -> None:
        bursts = int(rng.poisson(per_s * HORIZON_S)) if per_s > 0.0 else 0
        self._start_s = np.sort(rng.uniform(0.0, HORIZON_S, bursts))
        bit = rng.integers(LOWEST_BIT, HIGHEST_BIT + 1, bursts)
        self._jump_rad = rng.choice((-1.0, 1.0), bursts) * WORD_RAD * np.exp2(bit)

    def added_rad(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """At these times, same shape."""
        if not self._start_s.size:
            return np.zeros_like(time_s)
        latest = np.searchsorted(self._start_s, time_s, side="right") - 1
        burst = (latest >= 0) & (time_s < self._start_s[latest] + BURST_S)
        return np.where(burst, self._jump_rad[latest], 0.0)


def reported_rad(
    effects: Effects,
    bit_errors: BitErrors,
    time_s: NDArray[np.float64],
    load_rad: NDArray[np.float64],
    creep_rad: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The load angle as the encoder reports it; all of shape (n,)."""
    seen = load_rad - creep_rad
    if effects.vibration_rad != 0.0:
        seen = seen + effects.vibration_rad * np.sin(math.tau * effects.vibration_hz * time_s)
    reported = seen
    if effects.eccentricity_rad != 0.0:
        reported = reported + effects.eccentricity_rad * np.sin(
            seen + effects.eccentricity_phase_rad
        )
    if effects.misalignment_rad != 0.0:
        reported = reported + joint_error_rad(effects.misalignment_rad, seen)
    if effects.subdivision_rad != 0.0:
        reported = reported + effects.subdivision_rad * np.sin(effects.subdivision_lines * seen)
    if effects.quantum_rad != 0.0:
        reported = np.floor(reported / effects.quantum_rad) * effects.quantum_rad
    return reported + bit_errors.added_rad(time_s)


def joint_error_rad(angle_rad: float, th: NDArray[np.float64]) -> NDArray[np.float64]:
    """atan(tan th / cos angle) - th, without its jumps."""
    stretch = 1.0 / math.cos(angle_rad)
    sine, cosine = np.sin(th), np.cos(th)
    return np.arctan2(sine * cosine * (stretch - 1.0), cosine**2 + stretch * sine**2)
