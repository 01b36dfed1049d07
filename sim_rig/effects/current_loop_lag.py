"""Current-loop lag: the current follows its command with a first-order lag.

    t di/dt = i* - i

t  lag_s   time constant, one over the current loop's bandwidth

Memory: the current, and the command where the step begins and when it was last looked at. Over
a step the command is a straight line, and the current follows it exactly,

    i(h) = b' + e (i - b) - (1 - e) (b' - b) / x,   e = exp(-x),   x = h / t

from b at its beginning to b' at its end, which the last two looks foretell.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, LogUniform, Port, Value

_TINY = 1e-12
"""Of a time: what is divided by is the same for all steps alike, and is divided by once."""


class Params(NamedTuple):
    """Zero switches it off: the current is its command."""

    lag_s: Annotated[float, LogUniform(1e-5, 2e-3)] = 0.0


class Memory(NamedTuple):
    """The current; its command at the step's beginning, and when last looked at (A)."""

    current_a: Value = 0.0
    edge_a: Value = 0.0
    seen_a: Value = 0.0


def law(s: Any, z: Memory, p: Params) -> Any:
    """The mean current over the step, A; at a look, the current."""
    command = s.current_command_a
    per_since = 1.0 / np.maximum(s.since_s, _TINY)
    slope = (command - z.seen_a) * per_since
    edge = command + 0.5 * s.step_s * slope
    x = np.maximum(s.step_s / p.lag_s, _TINY)
    left = np.exp(-x)
    whole = (1.0 - left) / x
    mean = np.where(x > _TINY, whole, 1.0)
    share = (1.0 - mean) / x
    behind = (edge - z.edge_a) * share
    middle = np.where(x > _TINY, 0.5 * (edge - z.edge_a), 0.0)
    return z.edge_a + middle + (z.current_a - z.edge_a) * mean - behind


def advance(s: Any, z: Memory, p: Params, dt_s: float) -> Memory:
    """The current at the end of the step; a jump of the command leaves it where it is."""
    command = s.current_command_a
    per_since = 1.0 / np.maximum(s.since_s, _TINY)
    slope = (command - z.seen_a) * per_since
    edge = command + 0.5 * s.step_s * slope
    x = np.maximum(dt_s / p.lag_s, _TINY)
    left = np.exp(-x)
    share = (1.0 - left) / x
    behind = (edge - z.edge_a) * share
    end = edge + (z.current_a - z.edge_a) * left - behind
    return Memory(np.where(x > _TINY, end, z.current_a), edge, command)


EFFECT = Effect(
    port=Port.CURRENT,
    params=Params,
    law=law,
    memory=Memory,
    advance=advance,
    sample={"lag_s": 5e-4},
    shows="phase lag inside the loop: less damping, more overshoot",
    confused_with=(
        "transport_delay",
        "velocity_filter_lag",
        "viscous",
        "coupling_compliance",
        "inverter_dead_time",
    ),
    source="Leonhard, Control of Electrical Drives (2001), ch. 7",
)
