"""Encoder eccentricity: the load encoder's disc is not centred on its shaft.

    y <- y + a sin(theta_l + phi)

a    amplitude_rad   eccentricity over the track's radius
phi  phase_rad       phase: the error is zero and rising at theta_l = -phi

Changes the reading only: no dynamics, no lag, nothing in the current.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, LogUniform, Port, Uniform


class Params(NamedTuple):
    """Zero amplitude switches it off."""

    amplitude_rad: Annotated[float, LogUniform(1e-6, 1e-2)] = 0.0
    phase_rad: Annotated[float, Uniform(-np.pi, np.pi)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The reading, rad."""
    return s.measured_load_angle_rad + p.amplitude_rad * np.sin(s.load_angle_rad + p.phase_rad)


EFFECT = Effect(
    port=Port.LOAD_SENSOR,
    params=Params,
    law=law,
    sample={"amplitude_rad": 1e-3, "phase_rad": 0.5},
    shows="one period in a revolution, added to the load angle at once",
    confused_with=(
        "gravity_imbalance",
        "misalignment",
        "load_torque",
        "position_backlash",
        "position_friction",
    ),
    source="Heidenhain, Rotary Encoders (catalogue): 1 um at a radius of 25 mm is 8 arc seconds",
)
