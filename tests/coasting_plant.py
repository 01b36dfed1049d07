"""The paper's rig by hand: G(s) and a play, and a friction that is felt only without power.

Exact for a command that is held: with d = r - omega, z = integral of d, and
s = zeta wn, w = wn sqrt(1 - zeta^2),

    d' = -2 s d - wn^2 z,   z' = d,   theta = integral of r - (z - z_0)

so a step of any length is one rotation. Nothing of `sim_rig.model` is in it: thousands of runs are
played on it, each of hundreds of steps.
"""

import math

from sim_rig.plant import PlantOutputs
from sim_rig.settings import Nominal

COASTING_S = 0.1
STOPPED_RAD_S = 1e-9


class CoastingPlant:
    """Without power the velocity falls to 1/e in `COASTING_S`."""

    def __init__(self, nominal: Nominal) -> None:
        self._nominal = nominal
        self._s = nominal.damping_ratio * nominal.natural_frequency_rad_s
        self._stiffness = nominal.natural_frequency_rad_s**2
        self._w = math.sqrt(self._stiffness - self._s**2)
        self._half_gap_rad = 0.5 * nominal.backlash_gap_rad
        self._theta = self._omega = self._z = self._load = self._current = 0.0

    def advance(self, velocity_command_rad_s: float | None, duration_s: float) -> None:
        """Hold the command; None: no power, it comes to rest."""
        if velocity_command_rad_s is None:
            if self._omega:
                self._coast(duration_s)
            return
        s, w = self._s, self._w
        d, z = velocity_command_rad_s - self._omega, self._z
        falls = math.exp(-s * duration_s)
        cosine, sine = falls * math.cos(w * duration_s), falls * math.sin(w * duration_s) / w
        d, self._z = (
            d * cosine - (s * d + self._stiffness * z) * sine,
            z * cosine + (d + s * z) * sine,
        )
        self._omega = velocity_command_rad_s - d
        nominal = self._nominal
        self._current = (
            nominal.proportional_gain_a_s_per_rad * d + nominal.integral_gain_a_per_rad * self._z
        )
        self._turn(velocity_command_rad_s * duration_s - (self._z - z))

    def outputs(self) -> PlantOutputs:
        """The present state; changes nothing."""
        return PlantOutputs(self._theta, self._omega, self._current, self._load)

    def _coast(self, duration_s: float) -> None:
        falls = math.exp(-duration_s / COASTING_S)
        self._turn(self._omega * COASTING_S * (1.0 - falls))
        self._omega *= falls
        self._z = self._current = 0.0
        if abs(self._omega) < STOPPED_RAD_S:
            self._omega = 0.0

    def _turn(self, angle_rad: float) -> None:
        theta, half = self._theta + angle_rad, self._half_gap_rad
        self._theta = theta
        self._load = min(max(self._load, theta - half), theta + half)


def coasting(nominal: Nominal, _seed: int) -> CoastingPlant:
    """The factory for `plant = "tests.coasting_plant:coasting"`."""
    return CoastingPlant(nominal)
