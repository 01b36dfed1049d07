"""Command scale: the drive makes more or less velocity of a command than was meant.

    r <- r (1 + d)

d  error_fraction   relative error of the scale: of a gear ratio, counts, or an analogue input
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, Port, Uniform


class Params(NamedTuple):
    """Zero switches it off."""

    error_fraction: Annotated[float, Uniform(-0.02, 0.02, least=-0.99)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The command that is followed, rad/s."""
    return s.slot_command_rad_s * (1.0 + p.error_fraction)


EFFECT = Effect(
    port=Port.SLOT_COMMAND,
    params=Params,
    law=law,
    sample={"error_fraction": 0.01},
    shows="residual in proportion to the distance that was travelled; linear",
    confused_with=("command_deadband", "clock_skew", "command_offset"),
    source="analogue inputs of drives: gain error 0.1 to 1 %",
)
