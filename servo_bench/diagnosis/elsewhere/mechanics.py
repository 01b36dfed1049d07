"""From an effort to a motion: rows, selection, and the gain on what no fit saw."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from servo_bench.diagnosis.elsewhere import gate
from servo_bench.diagnosis.elsewhere.equation import (
    Design,
    Mask,
    base_design,
    covariance,
    design,
    electric_of,
    solve,
    usual_torques,
    weights,
)
from servo_bench.diagnosis.elsewhere.held import folds_of
from servo_bench.diagnosis.elsewhere.selection import Selected, select
from servo_bench.diagnosis.elsewhere.shown import Shown
from servo_bench.diagnosis.elsewhere.weak import (
    WeakRows,
    effort_noise,
    noise_share,
    weak_rows,
)
from servo_bench.diagnosis.fitting.foreign_channels import (
    Array,
    Motion,
    effort_of,
    stretches,
    velocity_lag_s,
)
from servo_bench.errors import ConfigError, FitError
from servo_bench.recording.recording import Recording

HALF, NEARLY_ALL = 0.5, 0.1
"""Of the acceleration, that selection explains at least; and of the effort's changes, what usual
torques leave at most where it goes into what resists (a slow ramp, speeds that are held)."""
ROUNDING = 1e-9
SIGNALS = {
    "current_a": ("current", "A"),
    "motor_current_a": ("current", "A"),
    "voltage_v": ("voltage", "V"),
}
MOTIONS: tuple[Motion, ...] = ("motor_velocity_rad_s", "motor_position_rad")


@dataclass(frozen=True)
class MechanicsFinding:
    """Everything that a verdict is written from; errors are of the acceleration, in rad/s2, or of
    the effort in its unit where the equation was solved for that (`inverse`).

    `before` and `after` are on held-out rows, `floor` is what the sensor makes, and `fit_before`,
    `fit_after` are 1 - (error/what it is of)^2 there, in the selection's weights.
    """

    recording: Recording
    effort: str
    motion: Motion
    lag_s: float
    selected: Selected
    covariance: Array
    before: float
    after: float
    floor: float
    moved: float
    fit_before: float
    fit_after: float
    shown: Shown

    @property
    def inverse(self) -> bool:
        """Whether the effort was explained by the motion."""
        return self.selected.design.inverse

    @property
    def quiet(self) -> bool:
        """Whether what was to be explained hardly changed where no fit saw it; an effort may have
        the size there that friction gives it."""
        told = bool(self.selected.steps) and self.after < HALF * self.before
        return self.moved <= gate.QUIET * self.floor and not (self.inverse and told)

    @property
    def voltage(self) -> bool:
        """Whether a voltage drives."""
        return self.effort == "voltage_v"


def judge_mechanics(
    recordings: Sequence[Recording],
    held_out: Recording | None = None,
    *,
    without: Collection[str] = (),
    only: Collection[str] = (),
) -> MechanicsFinding:
    """Select on the recordings, judge on the held-out one, else on the last fold of theirs. Where
    nothing explains the acceleration the equation is solved for the effort."""
    every = (*recordings, *((held_out,) if held_out is not None else ()))
    efforts = {effort_of(one) for one in every}
    if len(efforts) > 1:
        raise ConfigError(
            f"the recordings are driven by {' and '.join(sorted(efforts))}: diagnose those with "
            "the same effort together."
        )
    effort = efforts.pop()
    rows, motion = _rows(recordings, effort)
    unseen = _rows([held_out], effort, motion, rows.half)[0] if held_out is not None else None
    voltage = effort == "voltage_v"

    def found(*, inverse: bool) -> MechanicsFinding:
        chosen = select(rows, voltage=voltage, inverse=inverse, without=without, only=only)
        return _finding(recordings[0], effort, chosen, unseen)

    by_motion = found(inverse=False)
    if by_motion.fit_after < HALF and _plainly_left(rows, inverse=True) < NEARLY_ALL:
        by_effort = found(inverse=True)
        return by_motion if by_effort.quiet else by_effort
    return by_motion


def _finding(
    recording: Recording, effort: str, selected: Selected, unseen: WeakRows | None
) -> MechanicsFinding:
    """What was selected, on rows that took no part in it, else on the last fold of its own."""
    now, inverse = selected.design, selected.design.inverse
    rows, voltage = now.rows, now.voltage
    plain = base_design(rows, voltage=voltage, inverse=inverse)
    if unseen is not None:
        electric = electric_of(now, selected.coefficients)
        judged = design(unseen, now.terms, electric, voltage=voltage, inverse=inverse)
        judged_plain = base_design(unseen, voltage=voltage, inverse=inverse)
        fitted, here = np.ones(rows.left.size, bool), np.ones(unseen.left.size, bool)
    else:
        folds = folds_of(rows)
        here = folds == folds.max()
        fitted, judged, judged_plain = ~here, now, plain
    left = judged.target[here]
    scale = np.where(selected.weight > 0.0, 1.0, 0.0)
    errors = [
        left
        - seen.matrix[here]
        @ solve(made.matrix[fitted], made.target[fitted], (selected.weight * scale)[fitted])
        for made, seen in ((plain, judged_plain), (now, judged))
    ]
    weight = weights(judged.rows, judged.target - judged.matrix @ selected.coefficients)[here]
    if not weight.any():
        raise FitError("the held-out part never moves: give one in which the motor turns.")
    moves = left - (np.average(left, weights=weight**2) if inverse else 0.0)
    before, after, moved = (
        float(np.sqrt(np.average(e**2, weights=weight > 0.0))) for e in (*errors, moves)
    )
    about = max(float(np.sum((moves * weight) ** 2)), 1e-300)
    fits = [1.0 - float(np.sum((e * weight) ** 2)) / about for e in errors]
    return MechanicsFinding(
        recording=recording,
        effort=effort,
        motion=rows.motion,
        lag_s=velocity_lag_s(recording),
        selected=selected,
        covariance=covariance(now, selected.coefficients, selected.weight),
        before=before,
        after=after,
        floor=max(_floor(judged), ROUNDING * float(np.abs(left).max())),
        moved=moved,
        fit_before=fits[0],
        fit_after=fits[1],
        shown=_shown(effort, judged, here, left - np.stack(errors)),
    )


def _shown(effort: str, judged: Design, here: Mask, models: Array) -> Shown:
    """The acceleration in time, or the effort over the speed that it holds; `models` are the plain
    one and that with its causes, shape (2, rows)."""
    rows, plain, extended = judged.rows, *models
    time_s, speed = rows.column(lambda s: s.time_s)[here], rows.velocity_rad_s[here]
    told = (judged.target[here], plain, extended)
    if judged.inverse:
        about = signal_of(effort)
        return Shown(*about, "motor velocity", "rad/s", time_s, speed, *told)
    return Shown("motor acceleration", "rad/s2", "time", "s", time_s, time_s, *told)


def signal_of(effort: str) -> tuple[str, str]:
    """An effort's name and unit."""
    return SIGNALS.get(effort, ("torque", "N m"))


def _rows(
    recordings: Sequence[Recording], effort: str, motion: Motion | None = None, half: int = 0
) -> tuple[WeakRows, Motion]:
    """Weak rows of the motion that the effort explains best. FitError where there are too few."""
    if not any(np.nanstd(one[effort]) > 0.0 for one in recordings):
        raise FitError(
            f"{effort} never changes while the motor moves: what moved it is not known. Log the "
            "channel that holds it, or mend the map."
        )
    found: list[tuple[float, WeakRows, Motion]] = []
    for name in MOTIONS if motion is None else (motion,):
        if any(name not in one for one in recordings):
            continue
        parts = [s for k, one in enumerate(recordings) for s in stretches(one, k, name, effort)]
        if not parts:
            continue
        rows = weak_rows(parts, name, half)
        if rows.left.size:
            found.append((_plainly_left(rows), rows, name))
    if not found or int(found[0][1].block.max()) + 1 < gate.FEWEST_BLOCKS:
        raise FitError(
            f"less than {gate.FEWEST_BLOCKS} s without holes have both {effort} and the motor's "
            "motion. Record longer, or mend the map so that rows are kept."
        )
    _, rows, name = min(found, key=lambda one: one[0])
    if not float(rows.left.std()) > 0.0:
        raise FitError("the motor never moves: record with an effort that turns it.")
    return rows, name


def _plainly_left(rows: WeakRows, *, inverse: bool = False) -> float:
    """Share of the acceleration, or of the effort's changes, that the usual torques leave."""
    target = base_design(rows, voltage=False, inverse=inverse).target
    if inverse:
        target = target - target.mean()
    matrix = usual_torques(rows, inverse=inverse)
    errors = target - matrix @ solve(matrix, target, np.ones(target.size))
    return float(errors @ errors) / max(float(target @ target), 1e-300)


def _floor(judged: Design) -> float:
    """Rms of the sensor's noise in what is explained."""
    if judged.inverse:
        return effort_noise(judged.rows)
    return noise_share(judged.rows) * float(judged.rows.left.std())
