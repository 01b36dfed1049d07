"""How large things are on a rig under an excitation: what sizes of causes go with.

From the nominal rig's own simulation, so that a rig ten times as large is asked the same question.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from servo_bench.diagnosis.searching.unknowns import (
    USUAL_INERTIA_KG_M2,
    Unknown,
    about,
    nuisances,
)
from sim_rig.model import Model

USUAL_TORQUE_NM, LIGHTEST = 0.036, 0.4
"""Rms torque of a usual excitation on a rig of a hundred watts, a tenth of its rated one; and the
share of such a rig's inertia below which what it has of its own is no less."""
BETWEEN_S = 5e-4


class Scales(NamedTuple):
    """How large things are on this rig under this excitation; SI.

    `believed`: the effects that the rig's file has already, with their parameters.
    """

    torque_nm: float
    speed_rad_s: float
    current_a: float
    currents_a: tuple[float, ...]
    integral_a: tuple[float, ...]
    command_rad_s: float
    jump_rad_s: float
    gap_rad: float
    inertia_kg_m2: float
    peaks_a: tuple[float, ...] = ()
    flowing_a: float = 0.0
    integral_peak_a: float = 0.0
    seconds: float = 0.0
    integral_per_s: float = 0.0
    believed: tuple[tuple[str, Any], ...] = ()

    @property
    def strongest_a(self) -> float:
        """What flows for a fiftieth of the time, at the samples or between them: there a torque
        constant droops most."""
        return max(self.currents_a[0], self.flowing_a)

    @property
    def rig_torque_nm(self) -> float:
        """What friction and magnets have of their own is measured in: it goes with what a motor is
        rated for, and not with what this excitation asks of it.

        A family of motors has its torque as the cube of its size and its inertia as the fifth
        power. Coupling, bearings and encoder are the bench's, and no smaller on a lighter motor.
        """
        size = self.inertia_kg_m2 / USUAL_INERTIA_KG_M2
        return float(USUAL_TORQUE_NM * max(size, LIGHTEST) ** 0.6)

    @property
    def yielding(self) -> float:
        """Compliance of a spring over that of one of the same pitch on a rig of a hundred watts."""
        return yielding(self.inertia_kg_m2)


def yielding(inertia_kg_m2: float) -> float:
    """How much more a spring of the same pitch gives way than on a rig of a hundred watts."""
    return USUAL_INERTIA_KG_M2 / inertia_kg_m2


def scales_of(model: Model, commands_rad_s: np.ndarray, durations_s: np.ndarray | float) -> Scales:
    """From the nominal rig's own simulation. `currents_a` are high quantiles of its size at the
    samples, `peaks_a` of what flows between them (`flowing_a` is the second): a stiff loop's jump
    is over in a millisecond; `integral_peak_a` is the most that the controller's integral comes to,
    and that seldom.
    """
    nominal, done = model.nominal, model.simulate(commands_rad_s, durations_s)
    current = np.abs(done.motor_current_a)
    heard = np.append(0.0, commands_rad_s[:-1])  # a slot shows what the command before it did
    wanted = heard - done.motor_velocity_rad_s
    integral = np.abs(done.motor_current_a - nominal.proportional_gain_a_s_per_rad * wanted)
    jumps = np.diff(commands_rad_s)
    jumps = jumps[jumps != 0.0]
    rms = float(np.sqrt(np.mean(current**2)))
    peaks_a = _quantiles(_within(model, commands_rad_s, durations_s), (0.998, 0.98, 0.94))
    return Scales(
        torque_nm=max(rms * nominal.torque_constant_nm_per_a, 1e-9),
        speed_rad_s=max(float(np.sqrt(np.mean(done.motor_velocity_rad_s**2))), 1e-9),
        current_a=max(rms, 1e-9),
        currents_a=_quantiles(current, (0.98, 0.92, 0.8)),
        peaks_a=peaks_a,
        flowing_a=peaks_a[1],
        integral_a=_quantiles(integral, (0.98, 0.9, 0.75)),
        integral_peak_a=float(np.max(integral, initial=0.0)),
        command_rad_s=max(float(np.abs(commands_rad_s).max()), 1e-9),
        jump_rad_s=max(float(np.sqrt(np.mean(jumps**2))) if jumps.size else 0.0, 1e-9),
        gap_rad=nominal.backlash_gap_rad,
        inertia_kg_m2=nominal.inertia_kg_m2,
        seconds=done.end.time_s,
        integral_per_s=nominal.integral_gain_a_per_rad / nominal.proportional_gain_a_s_per_rad,
        believed=tuple(model.effects.items()),
    )


def band_of(scales: Scales, model: Model) -> tuple[Unknown, ...]:
    """What every fit has free on this rig, about what its file has."""
    return about(nuisances(scales.rig_torque_nm, scales.gap_rad, scales.integral_per_s), model)


def as_believed(model: Model, effect: str, scales: Scales) -> Model:
    """The model with an effect as the rig's file has it: mostly without."""
    params = dict(scales.believed).get(effect)
    without = model.without(effect)
    return without if params is None else without.with_effect(effect, **params._asdict())


def _within(
    model: Model, commands_rad_s: np.ndarray, durations_s: np.ndarray | float
) -> np.ndarray:
    """The size of the current a few times in every slot."""
    slots = np.broadcast_to(durations_s, commands_rad_s.shape)
    times = max(1, round(float(np.median(slots)) / BETWEEN_S)) if slots.size else 1
    often = model.simulate(np.repeat(commands_rad_s, times), np.repeat(slots / times, times))
    return np.abs(often.motor_current_a)


def _quantiles(values: np.ndarray, at: Sequence[float]) -> tuple[float, ...]:
    return tuple(max(float(q), 1e-9) for q in np.quantile(values, at))
