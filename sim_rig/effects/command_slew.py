"""Command slew: the drive's ramp generator lets the velocity command change only so fast.

    dr/dt = min(max((r* - r) / dt, -S), S),      S = 1 / q

r*  -                    command that arrives
q   slowness_s2_per_rad  one over the greatest acceleration S; zero for none

Memory: the command at the ramp's end. It is advanced exactly: a straight line to r*.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, LogUniform, Port, Value


class Params(NamedTuple):
    """Zero, an infinite slope, switches it off."""

    slowness_s2_per_rad: Annotated[float, LogUniform(1e-5, 2e-3)] = 0.0


class Memory(NamedTuple):
    """Where the ramp is (rad/s)."""

    ramp_rad_s: Value = 0.0


def law(s: Any, z: Memory, p: Params) -> Any:
    """The mean of the ramp over the step, rad/s; at a look, the ramp."""
    away = s.command_rad_s - z.ramp_rad_s
    needed_s = np.abs(away) * p.slowness_s2_per_rad
    climbing = 0.5 * s.step_s * np.sign(away) / p.slowness_s2_per_rad
    share = needed_s / np.maximum(s.step_s, needed_s + 1e-300)
    arriving = s.command_rad_s - z.ramp_rad_s - 0.5 * away * share
    return z.ramp_rad_s + np.where(needed_s >= s.step_s, climbing, arriving)


def advance(s: Any, z: Memory, p: Params, dt_s: float) -> Memory:
    """Where the ramp is at the end of the step."""
    away = s.command_rad_s - z.ramp_rad_s
    reach = dt_s / p.slowness_s2_per_rad
    return Memory(z.ramp_rad_s + np.minimum(np.maximum(away, -reach), reach))


EFFECT = Effect(
    port=Port.COMMAND,
    params=Params,
    law=law,
    memory=Memory,
    advance=advance,
    sample={"slowness_s2_per_rad": 5e-4},
    shows="after edges only, in proportion to the square of the step: ramps instead of steps",
    confused_with=("current_limit",),
    source="IEC 61800-7-201 (CiA 402), objects 0x6083 and 0x6084",
)
