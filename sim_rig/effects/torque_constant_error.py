"""Torque constant error: the motor makes more or less torque of its current than K_T says.

    tau <- tau (1 + d)

d  error_fraction   relative error of K_T
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, Port, Uniform


class Params(NamedTuple):
    """Zero switches it off."""

    error_fraction: Annotated[float, Uniform(-0.3, 0.3, least=-0.99)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The motor's torque, Nm."""
    return s.electric_torque_nm * (1.0 + p.error_fraction)


EFFECT = Effect(
    port=Port.ELECTRIC_TORQUE,
    params=Params,
    law=law,
    sample={"error_fraction": 0.1},
    shows="linear: 2 zeta wn and wn^2 scale alike",
    confused_with=("inertia_error", "viscous", "thermal_torque_constant", "torque_constant_droop"),
    source="data sheets of servo motors give K_T within 10 %",
)
