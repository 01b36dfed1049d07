"""A transmission with its output locked: the motor's angle under a slow torque.

    motor | coupling c_1 | the gear's friction T_f | gap W | faces c_2 | locked

    m = play of half width T_f, driven by tau - D      friction holds back what it may
    theta = c_1 tau + c_2 m + (W/2) sat(m / m_0) + zero

T_f  coulomb.torque_nm, more by asymmetric_friction.difference_torque_nm one way, and less the other
W    gap and backlash_width.change_rad
c_1  coupling_compliance.compliance_rad_per_nm, of what gives way before the friction
c_2  contact.compliance_rad_per_nm, behind it: this twist stays until friction lets go
m_0  a fifth of the largest torque: over which a gap is crossed, for friction is not one number

Nothing moves but slowly, so inertia, damping and the loop cannot be had from it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servo_bench.diagnosis.comparing.comparison import (
    FEWEST_POINTS,
    GROUP_S,
    Choice,
    Comparison,
    Signal,
)
from servo_bench.diagnosis.comparing.noise import floor_of
from servo_bench.diagnosis.comparing.playing import Source
from servo_bench.diagnosis.comparing.rows import Array, rows_of
from servo_bench.diagnosis.fitting.foreign_channels import torque_of
from servo_bench.errors import ConfigError, FitError
from servo_bench.recording.recording import Recording
from sim_rig.model import Model

ALIKE_PEAKS = 2.0
"""Runs whose largest torque is no more than so many times the gentlest's are taken: beyond, other
parts begin to give way."""
POINTS = 4000
CROSSING = 0.2
HELD_OUT_SHARE = 1.0 / 3.0
"""Of the runs, the last ones; of one run, its end."""


@dataclass(frozen=True, slots=True, eq=False)
class TwistComparison(Comparison):
    """`torque` is in N m, or in A where only a current was recorded; arrays of shape (points,)."""

    torque: Array
    run: NDArray[np.int64]
    amperes: bool

    def errors(self, model: Model) -> Array:
        """Measured minus held angle, each from a zero that nobody knows."""
        per_unit = model.nominal.torque_constant_nm_per_a if self.amperes else 1.0
        errors = self.measured - held_rad(model, per_unit * self.torque, self.run)
        return np.asarray(errors - np.median(errors))


def held_rad(model: Model, torque_nm: Array, run: NDArray[np.int64]) -> Array:
    """The motor's angle against a locked output, from zero; every run starts without tension."""
    gap = model.nominal.backlash_gap_rad
    gap = max(gap + _of(model, "backlash_width", "change_rad"), 0.0)
    before = _of(model, "coupling_compliance", "compliance_rad_per_nm")
    behind = _of(model, "contact", "compliance_rad_per_nm")
    middle_nm = _of(model, "asymmetric_friction", "difference_torque_nm")
    held = _dragged(torque_nm - middle_nm, run, _of(model, "coulomb", "torque_nm"))
    crossing = CROSSING * float(np.abs(torque_nm).max())
    crossed = 0.5 * gap * np.clip(held / crossing, -1.0, 1.0)
    return np.asarray(before * torque_nm + behind * held + crossed)


def compare_locked(
    recording: Recording, block: Choice = "auto", window_s: float | None = None
) -> TwistComparison:
    """Twist against torque, in the gentlest runs. FitError where there is too little of it."""
    if block not in ("auto", "transmission") or window_s is not None:
        raise ConfigError(
            f"block = {block}, window_s = {window_s}: the output was locked, so nothing but the "
            "transmission can be fitted, and whole. Leave --block and --window-s out."
        )
    rows, name = rows_of(recording), torque_of(recording)
    effort, twist = rows.channel(name), rows.channel("motor_position_rad")
    run = np.asarray(recording["run"] if "run" in recording else np.zeros(len(recording)), np.int64)
    chosen = _gentlest(effort, twist, run)
    kept = np.flatnonzero(chosen)[:: max(1, int(chosen.sum()) // POINTS)]
    seen = _first(run[kept])
    if seen.sum() < FEWEST_POINTS or effort[kept].min() >= 0.0 or effort[kept].max() <= 0.0:
        raise FitError(
            f"{kept.size} rows of torque and twist between {effort[kept].min(initial=0.0):g} and "
            f"{effort[kept].max(initial=0.0):g}, and a gap shows where torque reverses: record "
            "slow ramps to either side, twice at least, with the output locked."
        )
    floor = floor_of(rows, "motor_position_rad", increments=False)
    signal = Signal("twist", "rad", "motor_position_rad", "motor_position_rad", False, floor)
    return TwistComparison(
        block="transmission",
        window_s=None,
        signals=(signal,),
        source=Source("transmission", rows),
        pieces=(),
        measured=twist[kept][None, :],
        weight=np.ones(kept.size),
        seen=seen,
        held_out=~seen,
        group=np.unique(np.floor(rows.t_s[kept] / GROUP_S), return_inverse=True)[1],
        torque=effort[kept],
        run=run[kept],
        amperes=name == "current_a",
    )


def _of(model: Model, effect: str, field: str) -> float:
    return float(getattr(model.effects[effect], field)) if effect in model.effects else 0.0


def _dragged(torque_nm: Array, run: NDArray[np.int64], friction_nm: float) -> Array:
    """What friction lets through of a torque, run by run from nothing."""
    if friction_nm <= 0.0:
        return torque_nm
    found, now, before = [], 0.0, None
    for value, number in zip(torque_nm.tolist(), run.tolist(), strict=True):
        if number != before:
            now, before = 0.0, number
        now = min(max(now, value - friction_nm), value + friction_nm)
        found.append(now)
    return np.array(found)


def _gentlest(effort: Array, twist: Array, run: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Rows of the runs with the smallest peaks."""
    known = np.isfinite(effort) & np.isfinite(twist)
    peaks = {n: float(np.abs(effort[known & (run == n)]).max(initial=0.0)) for n in np.unique(run)}
    least = min((peak for peak in peaks.values() if peak > 0.0), default=0.0)
    chosen = [n for n, peak in peaks.items() if 0.0 < peak <= ALIKE_PEAKS * least]
    return np.asarray(known & np.isin(run, chosen))


def _first(run: NDArray[np.int64]) -> NDArray[np.bool_]:
    """What a fit may see: all but the last runs, or but the end of the only one."""
    numbers = np.unique(run)
    if numbers.size > 1:
        last = numbers[-max(1, round(HELD_OUT_SHARE * numbers.size)) :]
        return np.asarray(~np.isin(run, last))
    return np.asarray(np.arange(run.size) < (1.0 - HELD_OUT_SHARE) * run.size)
