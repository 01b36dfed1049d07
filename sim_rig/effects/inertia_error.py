"""Inertia error: rotor and load together are heavier or lighter than nominal.

    J <- J (1 + d)

d  error_fraction   relative error of J
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, Port, Uniform


class Params(NamedTuple):
    """Zero switches it off."""

    error_fraction: Annotated[float, Uniform(-0.3, 0.3, least=-0.99)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The total inertia, kg m^2."""
    return s.inertia_kg_m2 * (1.0 + p.error_fraction)


EFFECT = Effect(
    port=Port.INERTIA,
    params=Params,
    law=law,
    sample={"error_fraction": 0.1},
    shows="linear: 2 zeta wn and wn^2 scale alike",
    confused_with=("torque_constant_error", "thermal_torque_constant"),
    source="an estimate of the load's inertia is rarely better than 10 %",
)
