"""Inverter dead time: both switches of a phase are open for a moment, and the current notches.

    i <- i - (I / 2) (u - v),      t dv/dt = u - v,      u = m(p theta) tanh(i / i_0)

I    notch_a          depth of the notch when the current changes its sign
t    recovery_s       the current loop's integral time, in which it finds the lost voltage
p    pole_pair_count  electrical revolutions in one of the motor
i_0  transition_a     width of the smoothed sign change: the current's own ripple
u    -                lost voltage over its mean, m = (pi / 6) sum |sin(p theta + 2 pi k / 3)|
v    -                what of it the current loop makes up for

A phase loses V_dc t_d f_s against its current's sign. The current loop learns what is constant;
left are notches where the current crosses zero, and a ripple of 7 % at six times p, with jumps.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from sim_rig.effects.effect import Effect, Known, LogUniform, Port, Value

_TINY = 1e-12
_THIRD = 2.0943951023931953
_SIXTH = 0.5235987755982988


class Params(NamedTuple):
    """Zero depth switches it off."""

    notch_a: Annotated[float, LogUniform(1e-3, 2.0)] = 0.0
    recovery_s: Annotated[float, Known(1e-4, 2e-2)] = 2e-3
    pole_pair_count: Annotated[float, Known(1.0, 24.0)] = 4.0
    transition_a: Annotated[float, Known(0.02, 1.0)] = 0.2


class Memory(NamedTuple):
    """The lost voltage, over its mean, that the current loop makes up for."""

    learnt_ratio: Value = 0.0


def law(s: Any, z: Memory, p: Params) -> Any:
    """The mean current over the step, A."""
    angle = p.pole_pair_count * s.motor_angle_rad
    phases = np.abs(np.sin(angle)) + np.abs(np.sin(angle + _THIRD)) + np.abs(np.sin(angle - _THIRD))
    lost = _SIXTH * phases * np.tanh(s.current_a / p.transition_a)
    x = np.maximum(s.step_s / p.recovery_s, _TINY)
    mean = np.where(x > _TINY, (1.0 - np.exp(-x)) / x, 1.0)
    return s.current_a - 0.5 * p.notch_a * (lost - z.learnt_ratio) * mean


def advance(s: Any, z: Memory, p: Params, dt_s: float) -> Memory:
    """What is made up for at the end of the step."""
    angle = p.pole_pair_count * s.motor_angle_rad
    phases = np.abs(np.sin(angle)) + np.abs(np.sin(angle + _THIRD)) + np.abs(np.sin(angle - _THIRD))
    lost = _SIXTH * phases * np.tanh(s.current_a / p.transition_a)
    return Memory(lost + (z.learnt_ratio - lost) * np.exp(-dt_s / p.recovery_s))


EFFECT = Effect(
    port=Port.CURRENT,
    params=Params,
    law=law,
    memory=Memory,
    advance=advance,
    sample={"notch_a": 0.3},
    shows="notches where the current crosses zero; lines at six times the pole pairs",
    confused_with=("torque_ripple", "cogging", "current_loop_lag"),
    source="Jeong, Park, Dead-time effects in PWM inverters, IEEE Trans. Ind. Electron. 38 (1991)",
)
