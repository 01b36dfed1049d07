"""Sub-divisional error: the load encoder's interpolation is uneven within each line of its disc.

    y <- y + a sin(n theta_l + phi)

a    amplitude_rad  0.2 to 2 % of the line's pitch 2 pi / n
n    line_order     lines in a revolution; twice that where sine and cosine differ in gain
phi  phase_rad      phase: the error is zero and rising at n theta_l = -phi

Changes the reading only: nothing in the current, and the same at any speed.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Known, LogUniform, Port, Uniform


class Params(NamedTuple):
    """Zero amplitude switches it off."""

    amplitude_rad: Annotated[float, LogUniform(1e-7, 1e-3)] = 0.0
    line_order: Annotated[float, Known(64.0, 65536.0)] = 2048.0
    phase_rad: Annotated[float, Uniform(-np.pi, np.pi)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The reading, rad."""
    error = p.amplitude_rad * np.sin(p.line_order * s.load_angle_rad + p.phase_rad)
    return s.measured_load_angle_rad + error


EFFECT = Effect(
    port=Port.LOAD_SENSOR,
    params=Params,
    law=law,
    sample={"amplitude_rad": 5e-5},
    shows="a line at its order in the load angle's position spectrum, none in the current's",
    confused_with=("cogging", "quantisation"),
    source="Heidenhain, Rotary Encoders (catalogue): 1 to 2 % of the signal period",
)
