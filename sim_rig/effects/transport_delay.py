"""Transport delay: the command acts later than it was sent.

    r(t) <- r(t - D)

D  delay_s   any fraction of a period; the command's jumps are moved exactly
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, LogUniform, Port


class Params(NamedTuple):
    """Zero switches it off."""

    delay_s: Annotated[float, LogUniform(1e-6, 2e-2)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The delay, s."""
    return p.delay_s


EFFECT = Effect(
    port=Port.COMMAND_DELAY,
    params=Params,
    law=law,
    sample={"delay_s": 2e-3},
    shows="residual in proportion to velocity at all edges; the shape does not change",
    confused_with=("current_loop_lag", "clock_skew", "velocity_filter_lag", "missed_samples"),
    source="a fieldbus takes one or two of its cycles",
)
