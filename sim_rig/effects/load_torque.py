"""Load torque: a constant torque on the load's shaft.

    tau_l = T

T  torque_nm   a weight on a drum, a spring that hardly moves, a brake's drag one way

On a rigid load it reaches the motor while the motor pushes against it; otherwise the load is held
by friction. A load with a mass (contact) falls to one side of its gap, and presses on that face at
rest as well: give it one to play a dwell, in which a rigid load's torque dies away in the
motor's last tremble, the sooner the longer the steps.
"""

from typing import Annotated, Any, NamedTuple

from sim_rig.effects.effect import Effect, Port, Uniform


class Params(NamedTuple):
    """Zero torque switches it off."""

    torque_nm: Annotated[float, Uniform(-0.1, 0.1)] = 0.0


def law(s: Any, p: Params) -> Any:
    """Torque on the load, Nm."""
    return p.torque_nm


EFFECT = Effect(
    port=Port.LOAD_TORQUE,
    params=Params,
    law=law,
    sample={"torque_nm": 0.02},
    shows="mean current; the load rests on one side of its gap; even-order distortion",
    confused_with=("asymmetric_friction", "gravity_imbalance", "encoder_eccentricity"),
    source="statics",
)
