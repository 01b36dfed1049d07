"""How far numbers may go in data from elsewhere, whose motor is of another size than the rig's.

An effect's file states ranges for the rig. Here torques are measured by the torque T that drove the
motion (root mean square), and what is made of torque by T, the speed w and the angle a beside it:

    N m    T          N m s/rad    T/w          rad/(N m)    a/T

A number's spread is a tenth of its scale, and it is sought up to ten scales.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.rows import EFFORTS
from servo_bench.diagnosis.fitting.free import FreeParameter
from servo_bench.diagnosis.fitting.twist import TwistComparison
from sim_rig.model import Model

SPREAD, FARTHEST = 0.1, 10.0


def for_elsewhere(
    free: Sequence[FreeParameter], comparison: Comparison, model: Model
) -> tuple[FreeParameter, ...]:
    """The same numbers with the recording's own ranges; nominal values keep theirs."""
    scales = _scales(comparison, model)
    return tuple(_ranged(p, scales.get(p.unit, 0.0)) if p.effect else p for p in free)


def _ranged(parameter: FreeParameter, scale: float) -> FreeParameter:
    if not scale > 0.0:
        return parameter
    low = 0.0 if parameter.low == 0.0 else -FARTHEST * scale
    return replace(
        parameter,
        low=low,
        high=FARTHEST * scale,
        spread=SPREAD * scale,
        centre=SPREAD * scale if low == 0.0 else 0.0,
    )


def _scales(comparison: Comparison, model: Model) -> Mapping[str, float]:
    torque, speed = _torque_nm(comparison, model), _speed_rad_s(comparison)
    if not torque > 0.0:
        return {}
    scales = {"N m": torque}
    if isinstance(comparison, TwistComparison):
        scales["rad/(N m)"] = float(np.ptp(comparison.measured)) / torque
    if speed > 0.0:
        scales["N m s/rad"] = torque / speed
    return scales


def _torque_nm(comparison: Comparison, model: Model) -> float:
    """Root mean square; in torques per unit of the effort where nobody published K_T."""
    constant = model.nominal.torque_constant_nm_per_a
    if isinstance(comparison, TwistComparison):
        return _rms(comparison.torque) * (constant if comparison.amperes else 1.0)
    rows = comparison.source.rows
    for name in EFFORTS:
        if rows.has(name):
            return _rms(rows.channel(name)) * (constant if name == "current_a" else 1.0)
    return 0.0


def _speed_rad_s(comparison: Comparison) -> float:
    rows = comparison.source.rows
    if rows.has("motor_velocity_rad_s"):
        return _rms(rows.channel("motor_velocity_rad_s"))
    if not rows.has("motor_position_rad"):
        return 0.0
    whole = rows.even[:-1]
    speed = np.diff(rows.channel("motor_position_rad")) / np.diff(rows.t_s)
    return _rms(speed[whole])


def _rms(values: np.ndarray) -> float:
    came = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(came**2))) if came.size else 0.0
