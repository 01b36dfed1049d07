"""Misalignment: shafts that meet at an angle turn unevenly, twice in a revolution.

    y <- y + arctan(tan(theta_l + phi) / cos(b)) - (theta_l + phi)

b    angle_rad  between the shafts, or of the encoder's disc to its shaft
phi  phase_rad  of the joint

About b^2 / 4 sin(2 (theta_l + phi)). Added to the reading: no dynamics, nothing in the current.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, LogUniform, Port, Uniform


class Params(NamedTuple):
    """Zero angle switches it off."""

    angle_rad: Annotated[float, LogUniform(5e-3, 0.1, most=1.5)] = 0.0
    phase_rad: Annotated[float, Uniform(-np.pi, np.pi)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The reading, rad; the tangent of a difference, so that no branch is left or crossed."""
    tilt = np.cos(p.angle_rad)
    sine = np.sin(s.load_angle_rad + p.phase_rad)
    cosine = np.cos(s.load_angle_rad + p.phase_rad)
    ahead = np.arctan((1.0 - tilt) * sine * cosine / (tilt * cosine * cosine + sine * sine))
    return s.measured_load_angle_rad + ahead


EFFECT = Effect(
    port=Port.LOAD_SENSOR,
    params=Params,
    law=law,
    sample={"angle_rad": 0.05, "phase_rad": 0.3},
    shows="two periods in a revolution, added to the load angle at once",
    confused_with=("encoder_eccentricity",),
    source="Seherr-Thoss, Schmelz, Aucktor, Universal Joints and Driveshafts (2006), ch. 1",
)
