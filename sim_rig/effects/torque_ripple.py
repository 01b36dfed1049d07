"""Torque ripple: the current's torque depends on where the rotor stands.

    tau <- tau (1 + r sin(n p theta + phi))

r    ripple_fraction   amplitude over the mean torque
n    electrical_order  periods in an electrical revolution: 6 (12) from harmonics of the back-EMF,
                       2 from phase currents of unequal gain
p    pole_pair_count   electrical revolutions in one of the motor
phi  phase_rad         phase: it is zero and rising at n p theta = -phi

Needs current. An offset of a current sensor makes torque without: cogging of order p.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Known, LogUniform, Port, Uniform


class Params(NamedTuple):
    """Zero ripple switches it off."""

    ripple_fraction: Annotated[float, LogUniform(1e-3, 0.1, most=1.0)] = 0.0
    electrical_order: Annotated[float, Known(1.0, 24.0)] = 6.0
    pole_pair_count: Annotated[float, Known(1.0, 24.0)] = 4.0
    phase_rad: Annotated[float, Uniform(-np.pi, np.pi)] = 0.0


def law(s: Any, p: Params) -> Any:
    """The motor's torque, Nm."""
    angle = p.electrical_order * p.pole_pair_count * s.motor_angle_rad + p.phase_rad
    return s.electric_torque_nm * (1.0 + p.ripple_fraction * np.sin(angle))


EFFECT = Effect(
    port=Port.ELECTRIC_TORQUE,
    params=Params,
    law=law,
    sample={"ripple_fraction": 0.05},
    shows="a line at its order in the position spectrum, as high as the current is large",
    confused_with=("cogging", "inverter_dead_time"),
    source="Jahns, Soong, Pulsating torque minimization, IEEE Trans. Ind. Electron. 43 (1996)",
)
