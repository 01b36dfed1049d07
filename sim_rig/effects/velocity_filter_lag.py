"""Velocity-filter lag: the drive smooths the velocity that it makes of encoder counts.

    t dv/dt = omega - v

t  lag_s   time constant of the filter in the feedback path

Memory: the filter's output, and the velocity where the step begins and when it was last looked
at. Over a step the velocity is a straight line, and the filter follows it exactly (see
current_loop_lag). The motor's velocity as recorded is not filtered.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, LogUniform, Port, Value

_TINY = 1e-12
"""Of a time: what is divided by is the same for all steps alike, and is divided by once."""


class Params(NamedTuple):
    """Zero switches it off: the loop sees the velocity."""

    lag_s: Annotated[float, LogUniform(1e-5, 5e-3)] = 0.0


class Memory(NamedTuple):
    """The output; the velocity at the step's beginning, and when last looked at (rad/s)."""

    output_rad_s: Value = 0.0
    edge_rad_s: Value = 0.0
    seen_rad_s: Value = 0.0


def law(s: Any, z: Memory, p: Params) -> Any:
    """The filter's mean output over the step, rad/s; at a look, its output."""
    velocity = s.measured_velocity_rad_s
    per_since = 1.0 / np.maximum(s.since_s, _TINY)
    slope = (velocity - z.seen_rad_s) * per_since
    edge = velocity + 0.5 * s.step_s * slope
    x = np.maximum(s.step_s / p.lag_s, _TINY)
    left = np.exp(-x)
    whole = (1.0 - left) / x
    mean = np.where(x > _TINY, whole, 1.0)
    share = (1.0 - mean) / x
    behind = (edge - z.edge_rad_s) * share
    middle = np.where(x > _TINY, 0.5 * (edge - z.edge_rad_s), 0.0)
    return z.edge_rad_s + middle + (z.output_rad_s - z.edge_rad_s) * mean - behind


def advance(s: Any, z: Memory, p: Params, dt_s: float) -> Memory:
    """The output at the end of the step."""
    velocity = s.measured_velocity_rad_s
    per_since = 1.0 / np.maximum(s.since_s, _TINY)
    slope = (velocity - z.seen_rad_s) * per_since
    edge = velocity + 0.5 * s.step_s * slope
    x = np.maximum(dt_s / p.lag_s, _TINY)
    left = np.exp(-x)
    share = (1.0 - left) / x
    behind = (edge - z.edge_rad_s) * share
    end = edge + (z.output_rad_s - z.edge_rad_s) * left - behind
    return Memory(np.where(x > _TINY, end, z.output_rad_s), edge, velocity)


EFFECT = Effect(
    port=Port.VELOCITY_FEEDBACK,
    params=Params,
    law=law,
    memory=Memory,
    advance=advance,
    sample={"lag_s": 1e-3},
    shows="phase lag in the feedback: the response leads at first, then overshoots more",
    confused_with=("current_loop_lag", "transport_delay", "proportional_gain_error"),
    source="Ellis, Control System Design Guide (2012), ch. 14: filters in the velocity loop",
)
