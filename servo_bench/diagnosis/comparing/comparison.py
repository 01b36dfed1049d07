"""Measured minus simulated, signal by signal, for one recording and any model.

    load velocity, motor velocity   increments of the angle over the time between two samples, so
                                    that neither the start angle nor a slow drift counts
    current or torque               the drive's own figure, as it is
    speed                           the drive's own figure, where no motor angle came

A torque that a drive tells is its current times a K_T in its own memory: it is compared with the
simulated current times the K_T that the model had before the fit, and tells nothing of torque.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servo_bench.diagnosis.comparing.haar import SHORTEST_S, Haar, haar_of
from servo_bench.diagnosis.comparing.noise import floor_of, rests
from servo_bench.diagnosis.comparing.playing import Piece, Source
from servo_bench.diagnosis.comparing.rows import EFFORTS, Array, Mask, Rows, rows_of
from servo_bench.errors import ConfigError, FitError
from servo_bench.recording.blocks import Name, blocks_of
from servo_bench.recording.recording import Recording
from sim_rig.errors import SimRigError
from sim_rig.model import Model

Choice = Literal["auto", "controller", "mechanics", "transmission", "loop"]

SETTLE_POINTS = 32
"""After a start that is not measured: where the load lay in its gap is not known."""
WINDOW_S = 1.0
INCREMENT_S = 0.008
"""An open block's angles are compared over no less: over 1 ms they would be their quantum."""
GROUP_S = 0.25
"""Errors so far apart count as independent; within a window that started wrong, none do."""
FEWEST_POINTS = 64
CURRENTS = ("current_a", "motor_current_a")


@cache
def _threads(process: int) -> ThreadPoolExecutor:  # noqa: ARG001 - a forked one makes its own
    """A process's threads, one more than its cores: a search asks hundreds of times for models."""
    return ThreadPoolExecutor(len(os.sched_getaffinity(0)) + 1, "simulation")


class Signal(NamedTuple):
    """One signal that is compared. `factor` turns what is simulated into the channel's unit.

    An increment goes from the mean of `stride` points to the next; `less` is a channel that is
    subtracted (the twist is the load's angle less the motor's). Of a level nobody knows the zero:
    its error is taken from its median.
    """

    name: str
    unit: str
    channel: str
    simulated: str
    increments: bool
    floor: float
    factor: float = 1.0
    stride: int = 1
    less: str = ""
    level: bool = False


class _Points(NamedTuple):
    """One piece's points: each from row `start` to row `end`; and their longer increments."""

    piece: Piece
    start: NDArray[np.intp]
    end: NDArray[np.intp]
    haars: tuple[Haar | None, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """A recording as a fit sees it: errors of shape (signals, points), masks of shape (points,).

    `weight` is relative to the signal's floor: an increment over a longer time is better known.
    `group` tells which points' errors hang together.
    """

    block: Name
    window_s: float | None
    signals: tuple[Signal, ...]
    source: Source
    pieces: tuple[_Points, ...]
    measured: Array
    weight: Array
    seen: Mask
    held_out: Mask
    group: NDArray[np.int64]

    @property
    def longest(self) -> Piece:
        """The piece with most rows: a short one may hold a rest, or an end."""
        return max((points.piece for points in self.pieces), key=lambda p: p.last - p.first)

    @property
    def is_of_the_load_alone(self) -> bool:
        """Whether nothing but the load's encoder tells of the motor."""
        return all(signal.name.startswith("load") for signal in self.signals)

    def errors(self, model: Model) -> Array:
        """Measured minus simulated; NaN where nothing came. Raises SimRigError as a model does."""
        parts = []
        for points in self.pieces:
            shown = self.source.play(model, points.piece)
            parts.append(taken(self.signals, shown, points, self.source))
        errors = self.measured - np.concatenate(parts, axis=1)
        for k, signal in enumerate(self.signals):
            if signal.level and np.isfinite(errors[k]).any():
                errors[k] -= np.nanmedian(errors[k])
        return np.asarray(errors)

    def errors_of(self, models: Sequence[Model]) -> list[Array]:
        """The same for many models, over the machine's cores; all NaN where one cannot be run."""

        def errors(model: Model) -> Array:
            try:
                return self.errors(model)
            except SimRigError:
                return np.full_like(self.measured, np.nan)

        if len(models) == 1:
            return [errors(models[0])]
        return list(_threads(os.getpid()).map(errors, models))

    def rms(self, errors: Array, where: Mask) -> Array:
        """Root mean square over some points, shape (signals,); NaN where there is none."""
        chosen = np.where(where, errors, np.nan)
        known = np.isfinite(chosen).sum(axis=1)
        squares = np.nansum(chosen**2, axis=1)
        return np.sqrt(np.where(known > 0, squares / np.maximum(known, 1), np.nan))


def compare(
    recording: Recording,
    model: Model,
    block: Choice = "auto",
    window_s: float | None = None,
    *,
    scales: Sequence[int] = (),
) -> Comparison:
    """How this recording is compared with models such as `model`.

    With `scales` every angle is compared over increments between the means of so many rows, and as
    it is, from a zero of its own. Where both angles came, the motor's and the twist are compared
    instead of the motor's and the load's: what moves the motor is then told from what lies behind
    it, and what is slow from what is quick.

    Raises FitError where its channels do not suffice, where it is too short, or nothing moves;
    ConfigError where the block cannot be played so.
    """
    rows = rows_of(recording)
    name = _block(recording, block)
    current = _current(rows, model) if name in ("mechanics", "controller") else None
    window_s = _window(name, window_s)
    source = Source(name, rows, current if name == "mechanics" else None)
    signals = tuple(_signals(source, model))
    if scales:
        signals = tuple(_scaled(signals, rows, scales))
    stride = max(1, round(INCREMENT_S / rows.period_s)) if window_s is not None else 1
    cut = (_points(piece, stride) for piece in source.pieces(window_s))
    pieces = tuple(_with_haars(points, signals, rows) for points in cut)
    start = np.concatenate([p.start for p in pieces])
    elapsed_s = np.concatenate([rows.t_s[p.end] - rows.t_s[p.start] for p in pieces])
    measured = np.concatenate([_measured(signals, p, source) for p in pieces], axis=1)
    settled = np.concatenate([_settled(p, window_s) for p in pieces])
    whole = np.concatenate([_whole(rows, p) for p in pieces]) & settled
    comparison = Comparison(
        block=name,
        window_s=window_s,
        signals=signals,
        source=source,
        pieces=pieces,
        measured=np.where(whole, measured, np.nan),
        weight=elapsed_s / np.median(elapsed_s),
        seen=rows.seen[start] & whole,
        held_out=rows.held_out[start] & whole,
        group=_groups(rows, pieces, start, window_s),
    )
    _check(comparison)
    return comparison


def _block(recording: Recording, wanted: Choice) -> Name:
    there = {block.name: block for block in blocks_of(recording)}
    if recording.plant is not None and recording.plant.output_locked:
        raise FitError(
            "the output was locked: only twist over torque can be had from this recording, and no "
            "motion that a model could be fitted to. Record with the output free."
        )
    usable: list[Name] = []
    for name, block in there.items():
        needs = {
            "loop": "velocity_command_rad_s" in block.inputs
            and bool({"load_angle_rad", "motor_position_rad"} & set(block.outputs)),
            "mechanics": bool(set(EFFORTS) & set(block.inputs)),
            "transmission": "motor_position_rad" in block.inputs
            and "load_angle_rad" in block.outputs,
            "controller": {"velocity_command_rad_s", "motor_position_rad"} <= set(block.inputs)
            and bool(set(EFFORTS) & set(block.outputs)),
        }[name]
        usable += [name] if needs else []
    order: tuple[Name, ...] = ("loop", "mechanics", "transmission", "controller")
    for name in order:
        if name in usable and wanted in ("auto", name):
            return name
    asked = "no block" if wanted == "auto" else f"the {wanted} block not"
    raise FitError(
        f"{asked} of the rig can be fitted from {', '.join(sorted(recording.channels))}: can be "
        f"fitted here: {', '.join(usable) or 'none'}. Needed: velocity_command_rad_s and an angle "
        "(loop); a current or torque and the motor's motion (mechanics); motor and load angle "
        "(transmission)."
    )


def _window(block: Name, window_s: float | None) -> float | None:
    if window_s is None:
        return WINDOW_S if block == "mechanics" else None
    if block in ("loop", "controller"):
        raise ConfigError(
            f"window_s = {window_s}: the {block} has an integrator whose state nobody measured, so "
            "it is played whole. Leave the windows out, or fit the mechanics or the transmission."
        )
    if not window_s > 0.0:
        raise ConfigError(f"window_s = {window_s}: must be above zero; 1 s is usual.")
    return window_s


def _current(rows: Rows, model: Model) -> Array:
    name = next(name for name in EFFORTS if rows.has(name))
    per_unit = 1.0 if name in CURRENTS else 1.0 / model.nominal.torque_constant_nm_per_a
    return rows.channel(name) * per_unit


def _signals(source: Source, model: Model) -> Iterator[Signal]:
    block, rows = source.block, source.rows
    shown = _shown(source, model) if block == "loop" and "phase" not in rows.recording else {}

    def angle(name: str, channel: str) -> Iterator[Signal]:
        if rows.has(channel):
            floor = floor_of(rows, channel, increments=True, simulated=shown.get(channel))
            stride_s = max(rows.period_s, INCREMENT_S if block == "mechanics" else 0.0)
            yield Signal(name, "rad/s", channel, channel, True, floor / stride_s)

    if block in ("loop", "transmission"):
        yield from angle("load velocity", "load_angle_rad")
    if block in ("loop", "mechanics"):
        yield from angle("motor velocity", "motor_position_rad")
    if block == "mechanics" and not rows.has("motor_position_rad"):
        name = "motor_velocity_rad_s"
        floor = floor_of(rows, name, increments=False)
        yield Signal("motor speed", "rad/s", name, name, False, floor)
    if block in ("loop", "controller"):
        for name in EFFORTS:
            if rows.has(name):
                k_t = 1.0 if name in CURRENTS else model.nominal.torque_constant_nm_per_a
                current = k_t * shown["current_a"] if shown else None
                floor = floor_of(rows, name, increments=False, simulated=current)
                kind = ("current", "A") if name in CURRENTS else ("torque", "N m")
                yield Signal(*kind, name, "current_a", False, floor, k_t)
                return


def _shown(source: Source, model: Model) -> dict[str, Array]:
    """What the model shows at every row, by channel; nothing where it cannot be run."""
    shown: dict[str, Array] = {}
    for piece in source.pieces(None):
        try:
            played = source.play(model, piece)
        except SimRigError:
            return {}
        for name, values in played.items():
            shown.setdefault(name, np.full(len(source.rows.t_s), np.nan))[piece.rows] = values
    return shown


def _scaled(signals: Sequence[Signal], rows: Rows, scales: Sequence[int]) -> Iterator[Signal]:
    """The same signals over increments of several lengths, load and motor as motor and twist."""
    channels = {signal.channel for signal in signals}
    both = {"load_angle_rad", "motor_position_rad"} <= channels
    for signal in signals:
        if not signal.increments:
            yield signal
            continue
        twist = both and signal.channel == "load_angle_rad"
        name, less = signal.name, ""
        floor = signal.floor
        if twist:
            name, less = "twist", "motor_position_rad"
            motor = next(s for s in signals if s.channel == less)
            floor = float(np.hypot(floor, motor.floor))
        for stride in scales:
            over = f" over {stride * rows.period_s * 1e3:.4g} ms" if stride > 1 else ""
            yield signal._replace(
                name=f"{name}{over}", floor=floor / max(stride, 1) ** 1.5, stride=stride, less=less
            )
        if twist or not both:
            where = name.split()[0]
            yield signal._replace(
                name=f"{where} angle",
                unit="rad",
                increments=False,
                floor=floor * rows.period_s / np.sqrt(2.0),
                less=less,
                level=True,
            )


def _points(piece: Piece, stride: int) -> _Points:
    rows = np.arange(piece.first, piece.last, stride)
    return _Points(piece, rows[:-1], rows[1:])


def _measured(signals: Sequence[Signal], points: _Points, source: Source) -> Array:
    at = points.piece.rows
    names = {s.channel for s in signals} | {s.less for s in signals if s.less}
    shown = {name: source.rows.channel(name)[at] for name in names}
    own = [s._replace(factor=1.0, simulated=s.channel) for s in signals]
    return taken(own, shown, points, source)


def taken(
    signals: Sequence[Signal], shown: Mapping[str, Array], points: _Points, source: Source
) -> Array:
    """The signals at the points, shape (signals, points), from the channels at the piece's rows."""
    start, end = points.start - points.piece.first, points.end - points.piece.first
    elapsed_s = source.rows.t_s[points.end] - source.rows.t_s[points.start]
    elapsed_s = np.maximum(elapsed_s, SHORTEST_S)
    found = np.empty((len(signals), points.start.size))
    for k, signal in enumerate(signals):
        values = shown[signal.simulated]
        if signal.less:
            values = values - shown[signal.less]
        haar = points.haars[k] if signal.increments and signal.stride > 1 else None
        if not signal.increments:
            found[k] = values[end] * signal.factor
        elif haar is not None:
            found[k] = haar.of(values)
        else:
            found[k] = (values[end] - values[start]) / elapsed_s
    return found


def _with_haars(points: _Points, signals: Sequence[Signal], rows: Rows) -> _Points:
    """Where the signals' increments between means lie; of the others none."""
    first, at = points.piece.first, points.piece.rows
    edges = np.append(points.start, points.end[-1:])

    def of(signal: Signal) -> Haar | None:
        if not signal.increments or signal.stride == 1:
            return None
        came = np.isfinite(rows.channel(signal.channel)[at])
        if signal.less:
            came &= np.isfinite(rows.channel(signal.less)[at])
        return haar_of(rows, first, edges, signal.stride, came)

    return points._replace(haars=tuple(of(s) for s in signals))


def _whole(rows: Rows, points: _Points) -> Mask:
    """Points over undisturbed rows only."""
    uneven = np.concatenate(([0], np.cumsum(~rows.even)))
    return np.asarray(uneven[points.end] == uneven[points.start])


def _settled(points: _Points, window_s: float | None) -> Mask:
    settled = np.ones(points.start.size, np.bool_)
    if window_s is None:
        settled[:SETTLE_POINTS] = False
    return settled


def _groups(
    rows: Rows, pieces: tuple[_Points, ...], start: NDArray[np.intp], window_s: float | None
) -> NDArray[np.int64]:
    if window_s is not None:
        return np.repeat(np.arange(len(pieces)), [p.start.size for p in pieces])
    return np.floor(rows.t_s[start] / max(GROUP_S, 16 * rows.period_s)).astype(np.int64)


def _check(comparison: Comparison) -> None:
    known = np.isfinite(comparison.measured).any(axis=0)
    seen, held = int((known & comparison.seen).sum()), int((known & comparison.held_out).sum())
    if seen < FEWEST_POINTS or held < FEWEST_POINTS // 2:
        raise FitError(
            f"the recording is too short: {seen} points to fit and {held} held out; at least "
            f"{FEWEST_POINTS} and {FEWEST_POINTS // 2} are needed. Record a longer identification "
            "and validation."
        )
    moved = {
        s.name: float(np.nanstd(np.where(comparison.seen, values, np.nan))) / s.floor
        for s, values in zip(comparison.signals, comparison.measured, strict=True)
        if s.unit == "rad/s" and np.isfinite(values[comparison.seen]).any()
    }
    if moved and max(moved.values()) < 3.0:
        told = ", ".join(f"{name} {times:.1f} times its noise" for name, times in moved.items())
        if not rests(comparison.source.rows):
            raise FitError(
                f"motion and noise cannot be told apart in this recording: {told}, and nothing "
                "rests in it. Leave a second of rest in the recording, or record for longer."
            )
        raise FitError(
            f"nothing moves in this recording: {told}. Play an excitation that moves the axis, or "
            "check the sensors and the window."
        )
