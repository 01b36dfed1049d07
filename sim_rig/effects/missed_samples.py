"""Missed samples: now and then a command does not arrive, and the one before is held.

    r_k <- r_(k-1) with probability q

q  miss_probability   of each slot
   draw_seed          which slots: a hash of the slot's number and this
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Known, LogUniform, Port, Value

_A, _B, _C = 12.9898, 78.233, 43758.5453


class Params(NamedTuple):
    """Zero probability switches it off."""

    miss_probability: Annotated[float, LogUniform(1e-5, 1e-1, most=1.0)] = 0.0
    draw_seed: Annotated[float, Known(0.0, 1e4, above=-1.0)] = 0.0


class Memory(NamedTuple):
    """The command that is held (rad/s)."""

    held_rad_s: Value = 0.0


def law(s: Any, z: Memory, p: Params) -> Any:
    """The command that the drive has, rad/s."""
    draw = _C * np.sin(_A * s.slot + _B * p.draw_seed + 1.0)
    missed = draw - np.floor(draw) < p.miss_probability
    return np.where(missed, z.held_rad_s, s.slot_command_rad_s)


def advance(s: Any, z: Memory, p: Params, dt_s: float) -> Memory:
    """What the drive goes on with."""
    draw = _C * np.sin(_A * s.slot + _B * p.draw_seed + 1.0)
    missed = draw - np.floor(draw) < p.miss_probability
    return Memory(np.where(missed, z.held_rad_s, s.slot_command_rad_s))


EFFECT = Effect(
    port=Port.SLOT_COMMAND,
    params=Params,
    law=law,
    memory=Memory,
    advance=advance,
    sample={"miss_probability": 0.05},
    shows="sparse residuals as long as one slot, at edges only",
    confused_with=("transport_delay",),
    source="cyclic fieldbuses lose a frame in 1e-5 to 1e-2",
)
