"""The error without any model of its cause: in which signal, and what it repeats with.

`track_of` lays one signal's error of the base (nominal values and what every rig has) beside the
motion, row by row; `picture` says where it is locked to, in the verdict's words. The signal is the
one that is most in error, as a multiple of what a right simulation may miss (see `gate`). Errors
beyond six robust deviations (impacts) are clipped, so that a few do not outshout the rest.
"""

from dataclasses import dataclass

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison, Signal
from servo_bench.diagnosis.comparing.locking import (
    ORDERS,
    after_edges,
    binned_share,
    drift_share,
    line_shares,
)
from servo_bench.diagnosis.comparing.rows import Array, Mask
from servo_bench.diagnosis.judging.verdict import Line, Signature, Where
from servo_bench.diagnosis.searching.finding import Finding
from servo_bench.errors import ConfigError, FitError, RecordingError
from servo_bench.kernels.analysis import Analysis, analyse
from servo_bench.recording.recording import Recording
from sim_rig.model import Model

CLIP = 6.0
LEAST_SHARE = 0.1
"""Below, an error is called scattered."""
LEAST_LINE = 0.03
STILL_ROWS = 16
"""A command that was zero for so long: the rig stands."""
MOST_LINES = 3


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """One signal's error beside the base's motion; arrays of shape (points,), in time's order.

    `known` are points that a fit may see; elsewhere the error is zero.
    """

    signal: Signal
    time_s: Array
    error: Array
    known: Mask
    velocity_rad_s: Array
    angle_rad: Array
    current_a: Array
    jumps_rad_s: Array
    still: Mask
    times_allowed: float
    clipped_share: float

    def at_known(self, values: Array) -> Array:
        """The values at known points."""
        return values[self.known]


def worst_signal(finding: Finding) -> int:
    """The signal most in error among those over one row, levels, and efforts."""
    comparison = finding.whole.fitted[0]
    fine = [k for k, s in enumerate(comparison.signals) if s.stride == 1]
    misfit = np.nan_to_num(finding.misfit_before, nan=0.0)
    return max(fine, key=lambda k: float(misfit[k]))


def track_of(finding: Finding, signal: int | None = None) -> Track:
    """The track of one signal (by default the worst), over the first recording."""
    comparison, model = finding.whole.fitted[0], finding.base.model
    k = worst_signal(finding) if signal is None else signal
    error = comparison.errors(model)[k]
    known = np.isfinite(error) & comparison.seen
    centre = float(np.median(error[known])) if known.any() else 0.0
    sigma = 1.4826 * float(np.median(np.abs(error[known] - centre))) if known.any() else 0.0
    bound = CLIP * sigma if sigma > 0.0 else np.inf
    error = np.where(known, np.clip(np.nan_to_num(error) - centre, -bound, bound), 0.0)
    motion = _motion(comparison, model)
    start = np.concatenate([p.start for p in comparison.pieces])
    commands = _commands(comparison, start)
    return Track(
        signal=comparison.signals[k],
        time_s=comparison.source.rows.t_s[start],
        error=error,
        known=known,
        velocity_rad_s=motion[0],
        angle_rad=motion[1],
        current_a=motion[2],
        jumps_rad_s=np.diff(commands, prepend=commands[:1]),
        still=_still(commands),
        times_allowed=_times_allowed(finding, k),
        clipped_share=float(np.mean(np.abs(error) >= bound)) if known.any() else 0.0,
    )


def _times_allowed(finding: Finding, k: int) -> float:
    """Over one row or more: in sums over many rows an error stands out of the noise."""
    signals, misfit = finding.whole.fitted[0].signals, np.nan_to_num(finding.misfit_before)
    same = [j for j, other in enumerate(signals) if other.channel == signals[k].channel]
    return max(float(misfit[j]) for j in same)


def _motion(comparison: Comparison, model: Model) -> tuple[Array, Array, Array]:
    """Motor velocity, angle of the shaft, and current of the base, at the points' starts."""
    velocity, angle, current = [], [], []
    rows = comparison.source.rows
    for points in comparison.pieces:
        shown = comparison.source.play(model, points.piece)
        at = points.start - points.piece.first
        shaft = np.asarray(shown.get("motor_position_rad", shown.get("load_angle_rad", 0.0)))
        if shaft.ndim == 0:
            shaft = rows.channel("motor_position_rad")[points.piece.rows]
        speed = shown.get("motor_velocity_rad_s")
        t_s = rows.t_s[points.piece.rows]
        velocity.append((np.gradient(shaft, t_s) if speed is None else np.asarray(speed))[at])
        angle.append(shaft[at])
        given = comparison.source.current_a
        known = shown.get("current_a", given[points.piece.rows] if given is not None else None)
        current.append(np.zeros(at.size) if known is None else np.asarray(known)[at])
    return np.concatenate(velocity), np.concatenate(angle), np.concatenate(current)


def _commands(comparison: Comparison, start: np.ndarray) -> Array:
    rows = comparison.source.rows
    if not rows.has("velocity_command_rad_s"):
        return np.zeros(start.size)
    return np.asarray(np.nan_to_num(rows.channel("velocity_command_rad_s")[start]))


def _still(commands: Array) -> Mask:
    """Where the command has been zero for a while."""
    moved = np.concatenate(([0], np.cumsum(commands != 0.0)))
    first = np.maximum(np.arange(commands.size) - STILL_ROWS, 0)
    still = moved[1:] == moved[first]
    still[:STILL_ROWS] &= commands[0] == 0.0
    return np.asarray(still & (commands == 0.0))


def shares_of(track: Track) -> tuple[dict[str, float], tuple[Line, ...]]:
    """Share of the variance by domain (keys as `Where`), and the lines in it."""
    moving = track.known & ~track.still
    if moving.sum() < 4 * STILL_ROWS:
        return {"standstill": 1.0 if track.known.any() else 0.0}, ()
    error, angle = track.error[moving], track.angle_rad[moving]
    lines = _lines(track, angle, error, np.sign(track.velocity_rad_s[moving]))
    still = track.known & track.still
    energy = float(np.sum(track.error[track.known] ** 2))
    at_rest = float(np.sum(track.error[still] ** 2)) / energy if energy > 0.0 else 0.0
    return {
        "standstill": max(0.0, at_rest - still.sum() / track.known.sum()),
        "position": sum(line.share for line in lines),
        "velocity": binned_share(track.velocity_rad_s[moving], error),
        "edge": after_edges(track.jumps_rad_s, track.error, moving)[1],
        "drift": drift_share(track.time_s[moving], error),
        "current": binned_share(track.current_a[moving], error),
    }, lines


def _lines(track: Track, angle: Array, error: Array, direction: Array) -> tuple[Line, ...]:
    """The strongest orders, as they are or turning with the direction, two neighbours apart."""
    plain, turned = line_shares(angle, error), line_shares(angle, error, direction)
    best = np.maximum(plain, turned)
    found: list[Line] = []
    behind = "load" in track.signal.name or "twist" in track.signal.name
    for k in np.argsort(-best):
        if best[k] < LEAST_LINE or len(found) == MOST_LINES:
            break
        if all(abs(ORDERS[k] - line.order) > 1.5 for line in found):
            shaft = "load" if behind else "motor"
            found.append(
                Line.model_validate(
                    {"shaft": shaft, "order": float(ORDERS[k]), "share": float(best[k])}
                )
            )
    return tuple(found)


def picture(finding: Finding) -> Signature:
    """Where the base's error is locked to, in which block, and what kind of distortion was seen."""
    track = track_of(finding)
    shares, near = shares_of(track)
    lines = _with_torque_lines(finding, near)
    shares["position"] = min(1.0, max(shares.get("position", 0.0), *(x.share for x in lines), 0.0))
    where, share = max(shares.items(), key=lambda item: item[1])
    locked: Where = _where(where) if share >= LEAST_SHARE else "scattered"
    block = _block(finding)
    odd, even = distortion(finding.recordings[0])
    return Signature(
        locked_to=locked,
        shares={name: float(value) for name, value in shares.items()},
        lines=lines,
        block=block,
        odd=odd,
        even=even,
        words=_words(track, locked, share, lines, block),
    )


def _where(name: str) -> Where:
    known: dict[str, Where] = {
        "standstill": "standstill",
        "position": "position",
        "velocity": "velocity",
        "edge": "edge",
        "drift": "drift",
        "current": "current",
    }
    return known[name]


def _with_torque_lines(finding: Finding, near: tuple[Line, ...]) -> tuple[Line, ...]:
    """Lines of the angle itself, and those that `orders` found behind the loop's own dynamics."""
    found = {(line.shaft, round(line.order)): line for line in near}
    shafts = (("motor", finding.motor_lines), ("load", finding.load_lines))
    for shaft, every in shafts:
        for one in every:
            line = Line.model_validate(
                {"shaft": shaft, "order": one.order, "share": float(np.clip(one.share, 0.0, 1.0))}
            )
            key = (line.shaft, round(line.order))
            if key not in found or found[key].share < line.share:
                found[key] = line
    return tuple(sorted(found.values(), key=lambda line: -line.share)[: 2 * MOST_LINES])


def _block(finding: Finding) -> str | None:
    """Before or behind the gap, where both sides were measured."""
    names = finding.whole.names
    misfit = np.nan_to_num(finding.misfit_before)
    twist = [m for n, m in zip(names, misfit, strict=True) if n.startswith("twist")]
    before = [m for n, m in zip(names, misfit, strict=True) if not n.startswith(("twist", "load"))]
    if not twist or not before:
        return None
    return "transmission" if max(twist) > max(before) else "controller or mechanics"


def distortion(recording: Recording) -> tuple[float | None, float | None]:
    """Odd (order 3) and even (order 2) distortion of the measured response, over the linear one.

    (None, None) where the excitation or the channels do not let kernels be told.
    """
    found = kernels_of(recording)
    if found is None or found.energy_percent[0] <= 0.0:
        return None, None
    linear, even, odd = (max(share, 0.0) for share in found.energy_percent)
    return float(np.sqrt(odd / linear)), float(np.sqrt(even / linear))


def kernels_of(recording: Recording) -> Analysis | None:
    """The recording's kernels, or None where they cannot be had."""
    if recording.experiment is None or "load_angle_rad" not in recording:
        return None
    try:
        return analyse(recording)
    except (FitError, RecordingError, ConfigError):
        return None


WORDS = {
    "standstill": "stands there while the command is zero",
    "position": "repeats with the shaft's angle",
    "velocity": "goes with the velocity",
    "edge": "follows the command's changes",
    "drift": "drifts with time",
    "current": "goes with the current",
}


def _words(
    track: Track, locked: Where, share: float, lines: tuple[Line, ...], block: str | None
) -> str:
    text = (
        f"The {track.signal.name} is most in error, {track.times_allowed:.2g} times what a right "
        "simulation may miss"
    )
    if locked == "scattered":
        text += "; it goes with neither velocity, angle, current, nor time, and follows no command"
    else:
        text += f"; {100 * share:.0f} % of it {WORDS[locked]}"
    if locked == "position" and lines:
        times = "once" if lines[0].order == 1.0 else f"{lines[0].order:.4g} times"
        text += f", {times} a revolution of the {lines[0].shaft}"
    where = {"transmission": "behind the motor", "controller or mechanics": "before the gap"}
    return text + (f"; it sits {where[block]}." if block else ".")
