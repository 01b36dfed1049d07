"""Load friction: Coulomb friction at the load's shaft, behind the gap.

    tau_l = -T tanh(omega_l / omega_0)

T        torque_nm         sliding torque
omega_0  transition_rad_s  width of the smoothed sign change (numerical)

Decides whether the load coasts or stays in the gap. In a rigid play the load stays anyway, and
this is what the motor feels of it while it pushes.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Known, LogUniform, Port


class Params(NamedTuple):
    """Zero torque switches it off."""

    torque_nm: Annotated[float, LogUniform(1e-5, 0.05)] = 0.0
    transition_rad_s: Annotated[float, Known(0.05, 2.0)] = 0.5


def law(s: Any, p: Params) -> Any:
    """Torque on the load, Nm."""
    return -p.torque_nm * np.tanh(s.load_velocity_rad_s / p.transition_rad_s)


EFFECT = Effect(
    port=Port.LOAD_TORQUE,
    params=Params,
    law=law,
    sample={"torque_nm": 0.01},
    shows="as motor friction, but absent while the gap is crossed",
    confused_with=("coulomb", "contact", "viscous"),
    source="Nordin, Gutman, Automatica 38 (2002)",
)
