"""The diagnosis: from recordings to a verdict, stage by stage.

    hygiene     lost commands are put right and counted; a lattice of the load angle is looked for
    base        nominal model and its nuisances, fitted on the recording's beginning
    rounds      screen, fit, compete, accept; what is there but too small to matter is absorbed
    whole       everything accepted, on all that was recorded, in fine steps; backward deletion
    judgement   named, none, or unknown; confidence, rivals, limits, gain on data no fit saw

Causes are chosen on the recordings alone: fitted on the identification, judged on the validation.
A held-out recording takes no part in it. Only where commands were lost are its own put right, by
what the load did, because nobody can play a command that was not heard.
Every stage is a function of values and can be called alone. Nothing here reads files or clocks but
`time.perf_counter` for the time it took.
"""

import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.coasting import is_coasting, with_coasting
from servo_bench.diagnosis.comparison import Choice, compare
from servo_bench.diagnosis.evidence import Evidence, evidence_of, quick_evidence
from servo_bench.diagnosis.gate import is_noted, material_sizes, misfit, passes
from servo_bench.diagnosis.hygiene import (
    Lattice,
    LostCommands,
    heard,
    lattice,
    lost_commands,
    wild_samples,
)
from servo_bench.diagnosis.hypotheses import (
    Hypothesis,
    Scales,
    cogging_of,
    hypotheses,
    scales_of,
)
from servo_bench.diagnosis.joint import (
    SLOW,
    Named,
    fit_jointly,
    is_worth_it,
    needed_vehicle,
    own_unknowns,
    play_slow_round,
    worth_a_name,
)
from servo_bench.diagnosis.orders import (
    USUAL,
    MotorLines,
    OrderLine,
    Tone,
    Wave,
    load_lines,
    motor_lines,
    tone,
    torque_waves,
)
from servo_bench.diagnosis.rounds import (
    LEAST_GAIN,
    Round,
    Told,
    play_round,
)
from servo_bench.diagnosis.rows import Array
from servo_bench.diagnosis.seeking import Found, seek
from servo_bench.diagnosis.unknowns import Unknown, nuisances
from servo_bench.errors import FitError
from servo_bench.recording.recording import Recording
from sim_rig.model import Model

QUICK_ROWS = 2200
"""Rows of every recording on which candidates are tried: 18 s at 8 ms."""
MOST_ROUNDS = 5
MOST_CAUSES = 3
RIGHT_ALREADY = 0.7
"""Misfit below which a simulation with a cause named already needs good reasons for another."""
FURTHER_PROMISE = 0.008
"""Screened gain below which a further cause is then not even fitted."""


@dataclass(frozen=True)
class Finding:
    """Everything that a verdict is written from.

    `recordings` and `held_out` have the commands that the drive heard; `told` is the one that
    judges, with the commands that were sent.
    """

    recordings: tuple[Recording, ...]
    held_out: Recording | None
    told: Recording
    nominal: Model
    scales: Scales
    base: Found
    final: Found
    whole: Evidence
    named: tuple[Named, ...]
    absorbed: tuple[str, ...]
    lost: LostCommands
    lattice: Lattice | None
    motor_lines: tuple[OrderLine, ...]
    load_lines: tuple[OrderLine, ...]
    tone: Tone | None
    wild: int
    turns: float
    rounds: tuple[Round, ...]
    misfit_before: Array
    misfit_after: Array
    notes: tuple[str, ...] = ()
    seconds: float = 0.0


def nothing_told(_: str) -> None:
    """Progress that nobody wants."""


def find_causes(
    recordings: Sequence[Recording],
    model: Model,
    *,
    held_out: Recording | None = None,
    block: Choice = "auto",
    without: Collection[str] = (),
    only: Collection[str] = (),
    report: Told = nothing_told,
) -> Finding:
    """All stages but the verdict's words. Raises FitError where the data do not suffice."""
    began = time.perf_counter()
    told = tuple(recordings), held_out
    _need_command(told[0])
    ready = _ready(*told, model, block, without, report)
    recordings, held_out, lost = ready.recordings, ready.held_out, ready.lost
    quick, base, scales, band = ready.quick, ready.base, ready.scales, ready.band
    motor, waves, turns = ready.motor, ready.waves, _turns(quick)
    load = load_lines(quick.fitted[0], base.model)
    candidates = hypotheses(
        scales,
        motor_orders=[wave.order for wave in waves] or USUAL,
        waves=waves,
        ripple_orders=[_whole_order(line.order, turns) for line in motor.ripple] or USUAL,
        load_orders=[line.order for line in load],
        without=tuple(without),
        only=tuple(only),
    )
    now, named, absorbed, rounds = _rounds(quick, base, candidates, scales, report)
    report("joint fit on everything")
    whole = evidence_of(recordings, model, block=block)
    if lost.rows and _heard_after_all(whole, told[0], now, block):
        recordings, held_out, lost = *told, LostCommands((), lost.changes)
        whole = evidence_of(recordings, model, block=block)
    final, named = fit_jointly(whole, now, named, band, report)
    if not named and not absorbed:  # a line of its error may repeat with the shaft by chance
        final = with_coasting(whole, final)
    slow = [h for h in candidates if h.effect in SLOW - {n.effect for n in named}]
    late = play_slow_round(whole, final, slow, scales, report) if len(named) < MOST_CAUSES else None
    if late is not None:
        rounds.append(late.round)
        final, named = fit_jointly(whole, late.contender.found, [*named, late], band, report)
    if not is_coasting(final.model):  # its contact is no vehicle that a cause was tried on
        named += needed_vehicle(whole, final, named, band, report)
    plain = seek(whole, base.model, base.unknowns, iterations=1, first=2)
    before = misfit(whole, plain.errors)
    absorbed += [n.effect for n in named if not is_worth_it(n, final, scales)]
    absorbed += [n.effect for n in named if not is_noted(n.effect, before)]
    named = [n for one in named for n in worth_a_name(one, final, scales)]
    named = [n for n in named if is_noted(n.effect, before)]
    # judged beside what is known now: a motor that sticks stands on the command's own steps
    grid = None if "quantisation" in without else lattice(whole.fitted[0], final.model)
    report("coasting")
    if named or absorbed:
        final = with_coasting(whole, final)
    else:
        final = plain = with_coasting(whole, plain)
    return Finding(
        recordings=recordings,
        held_out=held_out,
        told=told[1] or told[0][0],
        nominal=model,
        scales=scales,
        base=plain,
        final=final,
        whole=whole,
        named=tuple(named),
        absorbed=tuple(absorbed),
        lost=lost,
        lattice=grid,
        motor_lines=motor.torque,
        load_lines=load,
        tone=tone(quick.fitted[0], now.model),
        wild=wild_samples(quick.fitted[0], now.model, scales.gap_rad),
        turns=turns,
        rounds=tuple(rounds),
        misfit_before=before,
        misfit_after=misfit(whole, final.errors),
        seconds=time.perf_counter() - began,
    )


class _Ready(NamedTuple):
    """Recordings as their drive heard them, and what is known before any cause is tried."""

    recordings: tuple[Recording, ...]
    held_out: Recording | None
    lost: LostCommands
    quick: Evidence
    base: Found
    scales: Scales
    band: tuple[Unknown, ...]
    motor: MotorLines
    waves: tuple[Wave, ...]


def _ready(  # noqa: PLR0917 - what `find_causes` was given
    recordings: tuple[Recording, ...],
    held_out: Recording | None,
    model: Model,
    block: Choice,
    without: Collection[str],
    report: Told,
) -> _Ready:
    """Hygiene and base fit."""
    report("data hygiene")
    quick = quick_evidence(recordings, model, QUICK_ROWS, block=block)
    longest_s = max(len(recording) * recording.period_s for recording in recordings)
    scales = _scales(quick, model)._replace(seconds=longest_s)
    band = nuisances(scales.torque_nm, scales.speed_rad_s, scales.gap_rad)
    report("base fit")
    base = seek(quick, model, band, iterations=4)
    report("position spectrum")
    motor, waves = _waves(quick, base.model)
    known = _nearer(quick, base, waves)
    lost = _lost(recordings, known, block, without)
    if lost.rows:
        recordings, held_out, lost = _put_right(recordings, held_out, known, block)
        quick = quick_evidence(recordings, model, QUICK_ROWS, block=block)
        base = seek(quick, model, band, iterations=4)
        motor, waves = _waves(quick, base.model)
    return _Ready(recordings, held_out, lost, quick, base, scales, band, motor, waves)


def _need_command(recordings: Sequence[Recording]) -> None:
    if any("velocity_command_rad_s" not in recording for recording in recordings):
        raise FitError(
            "a recording has no velocity command: the closed loop cannot be played from it. Record "
            "the command, or give measured data with current or voltage and motion alone."
        )


def _scales(quick: Evidence, model: Model) -> Scales:
    source = quick.fitted[0].source
    rows, piece = source.rows, source.pieces(quick.fitted[0].window_s)[0]
    commands = rows.channel("velocity_command_rad_s")[piece.rows]
    return scales_of(model, commands, model.simulate(commands, rows.durations_s[piece.rows]))


def order_tolerance(turns: float) -> float:
    """How far from a whole number an order may be found that is one: turns tell orders apart."""
    return max(0.12, 0.3 / max(turns, 0.3))


def _whole_order(order: float, turns: float) -> float:
    """The nearest whole order, where it is as near as the record's turns can tell."""
    return float(round(order)) if abs(order - round(order)) < order_tolerance(turns) else order


def _turns(quick: Evidence) -> float:
    """Full turns that the command asks for in the recording's beginning."""
    rows = quick.fitted[0].source.rows
    if not rows.has("velocity_command_rad_s"):
        return 0.0
    angle = np.nancumsum(rows.channel("velocity_command_rad_s") * rows.durations_s)
    return float(np.ptp(angle)) / (2.0 * np.pi)


def _waves(quick: Evidence, model: Model) -> tuple[MotorLines, tuple[Wave, ...]]:
    """Lines of the motor's shaft, and the torques at the orders that they mean."""
    found = motor_lines(quick.fitted[0], model)
    turns = _turns(quick)
    orders = dict.fromkeys(_whole_order(line.order, turns) for line in found.torque)
    return found, torque_waves(quick.fitted[0], model, tuple(orders))


def _nearer(quick: Evidence, base: Found, waves: Sequence[Wave]) -> Model:
    """The base, or the base with the waves that stand in its error where that is nearer."""
    if not waves:
        return base.model
    with_waves = base.model.with_effect("cogging", **cogging_of(waves))
    error = quick.seen([with_waves])[0]
    return with_waves if error.cost(base.sigma) < base.errors.cost(base.sigma) else base.model


def _lost(
    recordings: Sequence[Recording], known: Model, block: Choice, without: Collection[str]
) -> LostCommands:
    """What was lost in all recordings; rows are counted through them."""
    rows, changes, offset = list[int](), 0, 0
    for recording in recordings if "missed_samples" not in without else ():
        found = lost_commands(compare(recording, known, block), known)
        rows += [offset + row for row in found.rows]
        changes, offset = changes + found.changes, offset + len(recording)
    return LostCommands(tuple(rows), changes)


def _put_right(
    recordings: tuple[Recording, ...], held_out: Recording | None, model: Model, block: Choice
) -> tuple[tuple[Recording, ...], Recording | None, LostCommands]:
    """Every recording with the commands that were heard, and how many were lost in all."""
    every = [*recordings, *([held_out] if held_out is not None else [])]
    right, rows, changes = [], [], 0
    for number, recording in enumerate(every):
        found = lost_commands(compare(recording, model, block), model)
        again = heard(recording, found)
        more = lost_commands(compare(again, model, block), model)
        right.append(heard(again, more))
        if number < len(recordings):
            rows += [*found.rows, *more.rows]
            changes += found.changes
    judge = right.pop() if held_out is not None else None
    return tuple(right), judge, LostCommands(tuple(sorted(rows)), changes)


def _in_round(number: int, report: Told) -> Told:
    return lambda what: report(f"round {number}: {what}")


def _heard_after_all(
    whole: Evidence,
    told: Sequence[Recording],
    now: Found,
    block: Choice,
) -> bool:
    """Whether, with the causes known, the commands as sent explain the recording better."""
    sent = evidence_of(told, now.model, block=block)
    as_sent, as_heard = sent.seen([now.model])[0], whole.seen([now.model])[0]
    return as_sent.cost(now.sigma) <= as_heard.cost(now.sigma)


def _rounds(
    quick: Evidence,
    base: Found,
    candidates: Sequence[Hypothesis],
    scales: Scales,
    report: Told,
) -> tuple[Found, list[Named], list[str], list[Round]]:
    now, named, absorbed, rounds = base, list[Named](), list[str](), list[Round]()
    open_, sizes = list(candidates), material_sizes(scales)
    for number in range(MOST_ROUNDS):
        if not open_ or len(named) == MOST_CAUSES:
            break
        right = bool(named) and float(misfit(quick, now.errors).max()) < RIGHT_ALREADY
        least = FURTHER_PROMISE if right else LEAST_GAIN
        told = _in_round(number + 1, report)
        played = play_round(quick, now, open_, sizes, told, least=least)
        rounds.append(played)
        able = (c for c in played.contenders if passes(c, named=len(named), right=right))
        accepted = next(able, None)
        if accepted is None:
            break
        one = Named(accepted.effect, played, accepted, own_unknowns(accepted, accepted.effect))
        worth = worth_a_name(one, accepted.found, scales)
        named += worth
        absorbed += [] if one in worth else [one.effect]
        now = accepted.found
        open_ = [h for h in open_ if h.effect != accepted.effect]
    return now, named, absorbed, rounds
