"""Torque constant droop: iron saturates, and large currents make less than their torque.

    tau <- tau / (1 + s i^2)

s  droop_per_a2  one over the square of the current that makes half of its torque
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, LogUniform, Port


class Params(NamedTuple):
    """Zero switches it off."""

    droop_per_a2: Annotated[float, LogUniform(1e-5, 1e-2)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The motor's torque, Nm."""
    return s.electric_torque_nm / (1.0 + p.droop_per_a2 * s.current_a * s.current_a)


EFFECT = Effect(
    port=Port.ELECTRIC_TORQUE,
    params=Params,
    law=law,
    sample={"droop_per_a2": 1e-3},
    shows="after large reversals only, odd in the command: third-order distortion",
    confused_with=("torque_constant_error", "current_limit"),
    source="Hendershot, Miller, Design of Brushless Permanent-Magnet Machines (2010), ch. 7",
)
