"""What is known before any cause is tried: the base, the shaft's orders, and what was lost.

Which commands were lost is asked of a simulation that is as near as can be had at once: the
nominal model with its nuisances, and with the torques that stand in its error along the shaft. Else
what they do to single chips looks like a loss.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.comparison import CURRENTS, Choice, compare
from servo_bench.diagnosis.comparing.evidence import Evidence, evidence_of, quick_evidence
from servo_bench.diagnosis.comparing.rows import EFFORTS, Rows
from servo_bench.diagnosis.reading.channels import wrong_angles
from servo_bench.diagnosis.reading.lost import (
    LostCommands,
    heard,
    lost_by_playing,
    lost_commands,
)
from servo_bench.diagnosis.reading.orders import MotorLines, Wave, motor_lines, torque_waves
from servo_bench.diagnosis.reading.times import filled, jitter_s, on_even_times, with_rows_in_holes
from servo_bench.diagnosis.searching.hypotheses import cogging_of
from servo_bench.diagnosis.searching.rounds import Told
from servo_bench.diagnosis.searching.scales import Scales, band_of, scales_of
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.unknowns import Unknown
from servo_bench.errors import ChannelError
from servo_bench.recording.recording import Recording
from sim_rig.model import Model

QUICK_S, FEWEST_QUICK_ROWS = 17.6, 2200
"""Of every recording's beginning, on which candidates are tried; no fewer rows of a slow one."""
LONGER = 1.7
"""So many times that is looked at where it takes more to see what is small."""
FEW = 5
"""Samples of a current as large as a limit would leave many of; fewer may be a sensor's slips."""
MOST_OF_IT = 0.5
"""Of the base's cost, what waves may leave to be believed at once."""


class Ready(NamedTuple):
    """Recordings as their drive heard them, and what is known before any cause is tried; `told` are
    recordings and held-out one with the commands that were sent. `holes` are their rows that never
    came, recording by recording, the held-out one last."""

    recordings: tuple[Recording, ...]
    held_out: Recording | None
    lost: LostCommands
    quick: Evidence
    base: Found
    scales: Scales
    band: tuple[Unknown, ...]
    motor: MotorLines
    waves: tuple[Wave, ...]
    told: tuple[tuple[Recording, ...], Recording | None]
    holes: tuple[tuple[int, ...], ...] = ()
    notes: tuple[str, ...] = ()


def made_ready(
    recordings: tuple[Recording, ...],
    held_out: Recording | None,
    model: Model,
    *,
    block: Choice,
    without: Collection[str],
    report: Told,
) -> Ready:
    """Base fit, orders, and what was lost. ChannelError where an angle is not the rig's."""
    report("base fit")
    quick = quick_evidence(recordings, model, _quick_rows(recordings), block=block)
    longest_s = max(len(recording) * recording.period_s for recording in recordings)
    scales = _scales(quick, model)._replace(seconds=longest_s)
    band = band_of(scales, model)
    _refuse_wrong_angles(quick, model)
    base = seek(quick, model, band, iterations=4)
    timed = _timed(recordings, held_out, quick, base, block)
    if timed.notes:
        recordings, held_out = timed.recordings, timed.held_out
        quick = quick_evidence(recordings, model, _quick_rows(recordings), block=block)
        base = seek(quick, model, band, iterations=4)
    report("position spectrum")
    motor, waves = _waves(quick, base.model)
    known = _nearer(quick, base, waves)
    report("data hygiene")
    asked = recordings if "missed_samples" not in without else ()
    found = [_lost_of(recording, known, block) for recording in asked]
    lost, told = _counted(found, recordings), (recordings, held_out)
    if lost.rows:
        recordings, held_out, lost = _put_right(recordings, held_out, found, known, block)
        quick = quick_evidence(recordings, model, _quick_rows(recordings), block=block)
        base = seek(quick, model, band, iterations=4)
        motor, waves = _waves(quick, base.model)
    known_so_far = (lost, quick, base, scales, band, motor, waves)
    return Ready(recordings, held_out, *known_so_far, told, timed.holes, timed.notes)


def _refuse_wrong_angles(quick: Evidence, model: Model) -> None:
    """ChannelError where an angle is not the rig's: any law would be bent to what a map says."""
    wrong = [sentence for one in quick.fitted for sentence in wrong_angles(one, model)]
    if wrong:
        raise ChannelError(" ".join(dict.fromkeys(wrong)))


class _Timed(NamedTuple):
    recordings: tuple[Recording, ...]
    held_out: Recording | None
    holes: tuple[tuple[int, ...], ...]
    notes: tuple[str, ...]


def _timed(
    recordings: tuple[Recording, ...],
    held_out: Recording | None,
    quick: Evidence,
    base: Found,
    block: Choice,
) -> _Timed:
    """Recordings by the clock that their motion follows, with a command for every hole."""
    if quick.fitted[0].block != "loop":
        return _Timed(recordings, held_out, (), ())
    every, notes = [*recordings, *([held_out] if held_out is not None else [])], list[str]()
    even = [on_even_times(recording) for recording in every]
    clocked = [one or recording for one, recording in zip(even, every, strict=True)]
    strays_s = max(
        (jitter_s(r, one) for r, one in zip(every, even, strict=True) if one is not None),
        default=0.0,
    )
    if strays_s:
        first = tuple(clocked[: len(recordings)])
        other = quick_evidence(first, base.model, _quick_rows(first), block=block)
        kept, by_stamps = (
            seek(one, base.model, base.unknowns, iterations=2) for one in (other, quick)
        )
        if kept.errors.cost(base.sigma) < by_stamps.errors.cost(base.sigma):
            every, base = clocked, kept
            notes.append(
                f"The rows' times stray by {strays_s * 1e3:.2g} ms (rms) from an even clock, and "
                "the motion does not: it was compared by the even clock."
            )
    rowed = [with_rows_in_holes(recording) for recording in every]
    holes = tuple(rows for _, rows in rowed)
    missing = sum(len(rows) for rows in holes)
    if missing:
        every = [filled(recording, rows, base.model) for recording, rows in rowed]
        notes.append(
            f"{missing} times rows are missing, and with them the commands of that time: each was "
            "taken to be what the motor's way through the hole asks for."
        )
    judge = every.pop() if held_out is not None else None
    return _Timed(tuple(every), judge, holes if missing else (), tuple(notes))


def filled_again(ready: Ready, model: Model) -> Ready:
    """With the commands of the holes as a better model has them."""
    if not ready.holes:
        return ready

    def better(
        recordings: tuple[Recording, ...], held_out: Recording | None
    ) -> tuple[tuple[Recording, ...], Recording | None]:
        every = [*recordings, *([held_out] if held_out is not None else [])]
        again = [filled(one, rows, model) for one, rows in zip(every, ready.holes, strict=True)]
        judge = again.pop() if held_out is not None else None
        return tuple(again), judge

    recordings, held_out = better(ready.recordings, ready.held_out)
    told = better(*ready.told) if ready.lost.rows else (recordings, held_out)
    return ready._replace(recordings=recordings, held_out=held_out, told=told)


def longer_look(recordings: Sequence[Recording], model: Model, block: Choice) -> Evidence:
    """For what a load that coasts hides, whose simulation is slow: more than the quick look, and of
    a long recording not all."""
    return quick_evidence(recordings, model, _quick_rows(recordings, LONGER), block=block)


def _quick_rows(recordings: Sequence[Recording], times: float = 1.0) -> int:
    """Of the quick look: however fast the rows come, as much time is looked at."""
    period_s = min(recording.period_s for recording in recordings)
    return round(times * max(FEWEST_QUICK_ROWS, QUICK_S / period_s))


def order_tolerance(turns: float) -> float:
    """How far from a whole number an order may be found that is one: turns tell orders apart."""
    return max(0.12, 0.3 / max(turns, 0.3))


def whole_order(order: float, turns: float) -> float:
    """The nearest whole order, where it is as near as the record's turns can tell."""
    return float(round(order)) if abs(order - round(order)) < order_tolerance(turns) else order


def turns_of(quick: Evidence) -> float:
    """Full turns that the command asks for in the recording's beginning."""
    rows = quick.fitted[0].source.rows
    if not rows.has("velocity_command_rad_s"):
        return 0.0
    angle = np.nancumsum(rows.channel("velocity_command_rad_s") * rows.durations_s)
    return float(np.ptp(angle)) / (2.0 * np.pi)


def _waves(quick: Evidence, model: Model) -> tuple[MotorLines, tuple[Wave, ...]]:
    """Lines of the motor's shaft, and the torques at the orders that they mean."""
    found = motor_lines(quick.fitted[0], model)
    turns = turns_of(quick)
    orders = dict.fromkeys(whole_order(line.order, turns) for line in found.torque)
    return found, torque_waves(quick.fitted[0], model, tuple(orders))


def _nearer(quick: Evidence, base: Found, waves: Sequence[Wave]) -> Model:
    """The base, or the base with the waves that stand in its error where they are most of it.

    Lines by chance stand in every large error, and take a little of it.
    """
    if not waves:
        return base.model
    with_waves = base.model.with_effect("cogging", **cogging_of(waves))
    error = quick.seen([with_waves])[0]
    nearer = error.cost(base.sigma) < MOST_OF_IT * base.errors.cost(base.sigma)
    return with_waves if nearer else base.model


def _scales(quick: Evidence, model: Model) -> Scales:
    source = quick.fitted[0].source
    rows, piece = source.rows, quick.fitted[0].longest
    commands = rows.channel("velocity_command_rad_s")[piece.rows]
    scales = scales_of(model, commands, rows.durations_s[piece.rows])
    return scales._replace(peaks_a=(*_largest_a(rows, model), *scales.peaks_a))


def _largest_a(rows: Rows, model: Model) -> tuple[float, ...]:
    """The largest current that came more than a few times: where it was limited, the limit."""
    for name in EFFORTS:
        if rows.has(name):
            unit = 1.0 if name in CURRENTS else model.nominal.torque_constant_nm_per_a
            size = np.abs(rows.channel(name)) / unit
            size = np.sort(size[np.isfinite(size) & (size > 0.0)])
            return tuple(size[-FEW:][:1].tolist())
    return ()


def _counted(found: Sequence[LostCommands], recordings: Sequence[Recording]) -> LostCommands:
    """What was lost in all recordings; rows are counted through them."""
    rows, changes, offset = list[int](), 0, 0
    for one, recording in zip(found, recordings, strict=False):
        rows += [offset + row for row in one.rows]
        changes, offset = changes + one.changes, offset + len(recording)
    return LostCommands(tuple(rows), changes)


def _lost_of(recording: Recording, model: Model, block: Choice) -> LostCommands:
    comparison = compare(recording, model, block)
    if comparison.is_of_the_load_alone:
        return lost_by_playing(recording, model, block)
    return lost_commands(comparison, model)


def _put_right(
    recordings: tuple[Recording, ...],
    held_out: Recording | None,
    found: Sequence[LostCommands],
    model: Model,
    block: Choice,
) -> tuple[tuple[Recording, ...], Recording | None, LostCommands]:
    """Every recording with the commands that were heard, and how many were lost in all."""
    right, lost = [], []
    for recording, one in zip(recordings, found, strict=True):
        mended, all_of_it = _mended(recording, one, model, block)
        right.append(mended)
        lost.append(all_of_it)
    judge = held_out
    if held_out is not None:
        judge, _ = _mended(held_out, _lost_of(held_out, model, block), model, block)
    return tuple(right), judge, _counted(lost, recordings)


def _mended(
    recording: Recording, lost: LostCommands, model: Model, block: Choice
) -> tuple[Recording, LostCommands]:
    """With what was lost put right, and with what only shows then."""
    again = heard(recording, lost.rows)
    more = _lost_of(again, model, block).rows
    return heard(again, more), LostCommands(tuple(sorted({*lost.rows, *more})), lost.changes)


def heard_after_all(
    whole: Evidence,
    told: Sequence[Recording],
    now: Found,
    block: Choice,
) -> bool:
    """Whether, with the causes known, the commands as sent explain the recording better."""
    sent = evidence_of(told, now.model, block=block)
    as_sent, as_heard = sent.seen([now.model])[0], whole.seen([now.model])[0]
    return as_sent.cost(now.sigma) <= as_heard.cost(now.sigma)
