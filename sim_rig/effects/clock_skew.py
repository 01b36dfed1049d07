"""Clock skew: the rig's clock and the logger's run at different rates.

    t <- t (1 + k)

k  skew_fraction   relative difference of the clocks, 1e-6 is 1 ppm
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, Port, Uniform


class Params(NamedTuple):
    """Zero switches it off."""

    skew_fraction: Annotated[float, Uniform(-2e-4, 2e-4, least=-0.1, most=0.1)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The slot's length on the rig's clock, s."""
    return s.slot_duration_s * (1.0 + p.skew_fraction)


EFFECT = Effect(
    port=Port.SLOT_DURATION,
    params=Params,
    law=law,
    sample={"skew_fraction": 1e-4},
    shows="a delay that grows in proportion to time",
    confused_with=("transport_delay", "thermal_friction", "command_scale", "command_offset"),
    source="quartz oscillators: 5 to 100 ppm",
)
