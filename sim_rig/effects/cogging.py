"""Cogging: the rotor's magnets and the stator's teeth attract, at up to three orders.

    tau = sum_k T_k sin(n_k theta + phi_k)

T_k    torque_nm, second_torque_nm, third_torque_nm    amplitudes
n_k    order, second_order, third_order                periods in a revolution of the motor
phi_k  phase_rad, second_phase_rad, third_phase_rad

Orders are the slots, the poles, and their least common multiple (8 poles, 12 slots: 8, 12, 24).
Needs no current.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Known, LogUniform, Port, Uniform

PLACES = ("", "second_", "third_")
"""What the names of each line's parameters begin with."""


class Params(NamedTuple):
    """Three zero amplitudes switch it off."""

    torque_nm: Annotated[float, LogUniform(1e-5, 0.05)] = 0.0
    second_torque_nm: Annotated[float, LogUniform(1e-5, 0.05)] = 0.0
    third_torque_nm: Annotated[float, LogUniform(1e-5, 0.05)] = 0.0
    order: Annotated[float, Known(1.0, 120.0)] = 24.0
    second_order: Annotated[float, Known(1.0, 120.0)] = 12.0
    third_order: Annotated[float, Known(1.0, 120.0)] = 8.0
    phase_rad: Annotated[float, Uniform(-np.pi, np.pi)] = 0.0
    second_phase_rad: Annotated[float, Uniform(-np.pi, np.pi)] = 0.0
    third_phase_rad: Annotated[float, Uniform(-np.pi, np.pi)] = 0.0


def law(s: Any, p: Params) -> Any:
    """Torque on the motor, Nm."""
    theta = s.motor_angle_rad
    first = p.torque_nm * np.sin(p.order * theta + p.phase_rad)
    second = np.where(
        p.second_torque_nm != 0.0,
        p.second_torque_nm * np.sin(p.second_order * theta + p.second_phase_rad),
        0.0,
    )
    third = np.where(
        p.third_torque_nm != 0.0,
        p.third_torque_nm * np.sin(p.third_order * theta + p.third_phase_rad),
        0.0,
    )
    return first + second + third


EFFECT = Effect(
    port=Port.MOTOR_TORQUE,
    params=Params,
    law=law,
    strengths=("torque_nm", "second_torque_nm", "third_torque_nm"),
    sample={"torque_nm": 0.01, "order": 24.0},
    shows="a line at its order in the position spectrum of current and load angle, at any speed",
    confused_with=("torque_ripple", "encoder_subdivision", "inverter_dead_time"),
    source="Hendershot, Miller, Design of Brushless Permanent-Magnet Machines (2010), ch. 8",
)
