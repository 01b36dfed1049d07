"""Thermal torque constant: magnets lose flux as they warm up, and the motor its torque.

    tau <- tau (1 - d (1 - exp(-t / t_w)))

d    drop_fraction  how much of K_T is lost when warm: 0.1 %/K (NdFeB), 0.2 %/K (ferrite)
t_w  warming_s      thermal time constant
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Known, LogUniform, Port


class Params(NamedTuple):
    """Zero drop switches it off."""

    drop_fraction: Annotated[float, LogUniform(1e-3, 0.2, most=0.99)] = 0.0
    warming_s: Annotated[float, Known(60.0, 1800.0)] = 600.0


def law(s: Any, p: Params) -> Any:
    """The motor's torque, Nm."""
    return s.electric_torque_nm * (1.0 + p.drop_fraction * np.expm1(-s.time_s / p.warming_s))


EFFECT = Effect(
    port=Port.ELECTRIC_TORQUE,
    params=Params,
    law=law,
    sample={"drop_fraction": 0.1, "warming_s": 60.0},
    shows="a torque constant that is fitted window by window falls with time",
    confused_with=("torque_constant_error", "inertia_error"),
    source="data sheets of magnets: temperature coefficient of remanence, -0.1 %/K NdFeB",
)
