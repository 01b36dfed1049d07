"""Command offset: the drive adds a small velocity to every command.

    r <- r + o

o  offset_rad_s   what it does when told to stand still

Acts on the command that is sent, before an error of its scale.
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, Port, Uniform


class Params(NamedTuple):
    """Zero switches it off."""

    offset_rad_s: Annotated[float, Uniform(-1.0, 1.0)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The command that is followed, rad/s."""
    return s.slot_command_rad_s + p.offset_rad_s


EFFECT = Effect(
    port=Port.SLOT_COMMAND,
    params=Params,
    law=law,
    sample={"offset_rad_s": 0.05},
    shows="the angle drifts by o t, at standstill too; no current once it turns",
    confused_with=("command_scale", "clock_skew"),
    source="analogue inputs of drives: 0.01 to 0.5 % of full scale",
)
