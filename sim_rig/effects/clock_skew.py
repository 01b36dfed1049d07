"""Clock skew: the rig's clock and the logger's run apart, and the command falls behind or ahead.

    D(t) = k t

k  skew_fraction   relative difference of the clocks, 1e-6 is 1 ppm
D  -               how much later than the logger believes a command acts

With k < 0 it is the samples that come late, and the next command may act before the logger
believes it sent. A schedule that is known whole is played so (see `sim_rig.model.ahead`); a rig
on the wire, which knows no next command, lets it act at once.
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, Port, Uniform


class Params(NamedTuple):
    """Zero switches it off."""

    skew_fraction: Annotated[float, Uniform(-2e-4, 2e-4, least=-0.1, most=0.1)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The delay, s."""
    return p.skew_fraction * s.time_s


EFFECT = Effect(
    port=Port.COMMAND_DELAY,
    params=Params,
    law=law,
    sample={"skew_fraction": 1e-4},
    shows="a delay that grows in proportion to time",
    confused_with=("transport_delay", "thermal_friction", "command_scale", "command_offset"),
    source="quartz oscillators: 5 to 100 ppm",
)
