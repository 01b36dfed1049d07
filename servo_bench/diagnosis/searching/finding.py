"""The diagnosis: from recordings to a verdict, stage by stage.

    thinning    of rows in which no command can have changed, one is kept; by the recordings alone
    base        nominal model and its nuisances, fitted on the recording's beginning
    hygiene     lost commands are put right and counted
    rounds      screen, fit, compete, accept; what is there but too small to matter is absorbed;
                once more from another beginning, where they lead nowhere (`forking`)
    whole       everything accepted, on all that was recorded, in fine steps; backward deletion;
                a cause against its near rivals (`runoff`); what only all of it shows (`late`);
                a cause beside what was as good and changes something else (`unlike`)
    lattice     of the load angle, where the simulation with its causes does not stand on it too;
                and what its encoder says wrong by itself, where that was too faint for a round
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

import numpy as np

from servo_bench.diagnosis.comparing.allowance import SCALES
from servo_bench.diagnosis.comparing.comparison import Choice, compare
from servo_bench.diagnosis.comparing.evidence import Evidence, evidence_of
from servo_bench.diagnosis.comparing.rounding import rounding
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.comparing.scatter import scatter
from servo_bench.diagnosis.comparing.thinning import rows_to_a_command, thinned
from servo_bench.diagnosis.comparing.ticks import ticks
from servo_bench.diagnosis.comparing.unevenness import unevenness
from servo_bench.diagnosis.reading.creep import Creep, creep
from servo_bench.diagnosis.reading.crossing import crossing_s
from servo_bench.diagnosis.reading.hygiene import (
    Lattice,
    lattice,
    spoilt_words,
    wild_samples,
    without_spoilt_words,
)
from servo_bench.diagnosis.reading.lost import LostCommands
from servo_bench.diagnosis.reading.orders import USUAL, OrderLine
from servo_bench.diagnosis.reading.reading import Reading
from servo_bench.diagnosis.reading.subdivision import load_lines
from servo_bench.diagnosis.reading.tone import Tone, tone
from servo_bench.diagnosis.searching.bounces import bounces
from servo_bench.diagnosis.searching.coasting import (
    OTHERWISE,
    coasting_or_rested,
    is_coasting,
    with_coasting,
)
from servo_bench.diagnosis.searching.contenders import Round
from servo_bench.diagnosis.searching.forking import rounds_of
from servo_bench.diagnosis.searching.gate import RIGHT_ALREADY, is_noted, misfit
from servo_bench.diagnosis.searching.hypotheses import DETECTED, hypotheses
from servo_bench.diagnosis.searching.joint import (
    Named,
    fit_jointly,
    is_worth_it,
    needed_vehicle,
    worth_a_name,
)
from servo_bench.diagnosis.searching.late import (
    Late,
    asked_again,
    asked_late,
    unsure,
)
from servo_bench.diagnosis.searching.letting_go import (
    Doubt,
    doubts,
    without_idle,
    without_stand_ins,
)
from servo_bench.diagnosis.searching.lighter import on_a_light_load
from servo_bench.diagnosis.searching.one_gain import as_one_gain
from servo_bench.diagnosis.searching.reading_off import READ_OFF, with_readings
from servo_bench.diagnosis.searching.readying import (
    filled_again,
    heard_after_all,
    longer_look,
    made_ready,
    turns_of,
    whole_order,
)
from servo_bench.diagnosis.searching.rounds import Told
from servo_bench.diagnosis.searching.runoff import couplings_again, run_off
from servo_bench.diagnosis.searching.scales import Scales
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.unlike import beside_the_unlike
from servo_bench.errors import FitError
from servo_bench.recording.recording import Recording
from sim_rig.model import Model

LOAD = "load_angle_rad"


@dataclass(frozen=True)
class Finding:
    """Everything that a verdict is written from.

    `recordings` and `held_out` have the commands that the drive heard; `told` is the one that
    judges, with the commands that were sent; all of them thinned to a row or two a command.
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
    readings: tuple[Reading, ...]
    motor_lines: tuple[OrderLine, ...]
    load_lines: tuple[OrderLine, ...]
    tone: Tone | None
    creep: Creep | None
    wild: int
    turns: float
    rounds: tuple[Round, ...]
    doubts: tuple[Doubt, ...]
    misfit_before: Array
    misfit_after: Array
    notes: tuple[str, ...] = ()
    narrowed: bool = False
    seconds: float = 0.0

    @property
    def quantum_rad(self) -> float:
        """Of the load's angle, where it lies on a lattice of its own; else zero."""
        return self.lattice.quantum_rad if self.lattice is not None else 0.0


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
    _need_command(recordings)
    rows = rows_to_a_command(recordings) if block in ("auto", "loop") else 1
    came, thin = recordings[0], _thinned(recordings, held_out, rows, model)
    out = _not_asked(without, only)
    ready = made_ready(*thin, model, block=block, without=out, report=report)
    quick, base, scales, band = ready.quick, ready.base, ready.scales, ready.band
    motor, waves, turns = ready.motor, ready.waves, turns_of(quick)
    load = load_lines(compare(ready.recordings[0], base.model, block), base.model)
    candidates = hypotheses(
        scales,
        motor_orders=[wave.order for wave in waves] or USUAL,
        waves=waves,
        ripple_orders=[whole_order(line.order, turns) for line in motor.ripple] or USUAL,
        load_orders=[line.order for line in load],
        crossed_s=crossing_s(quick.judging[0], base.model),
        without=tuple(without),
        only=tuple(only),
    )
    now, named, absorbed, rounds, failed, _ = rounds_of(quick, base, candidates, scales, report)
    ready = filled_again(ready, now.model)
    recordings, held_out, lost, told = ready.recordings, ready.held_out, ready.lost, ready.told
    report("joint fit on everything")
    whole = evidence_of(recordings, now.model, block=block)
    if lost.rows and heard_after_all(whole, told[0], now, block):
        recordings, held_out, lost = *told, LostCommands((), lost.changes)
        whole = evidence_of(recordings, now.model, block=block)
    final, named = fit_jointly(whole, now, named, band, report, small=len(absorbed))
    if named and ready.holes and recordings is ready.recordings:
        ready = filled_again(ready, final.model)
        recordings, held_out, told = ready.recordings, ready.held_out, ready.told
        whole = evidence_of(recordings, final.model, block=block)
        final, named = fit_jointly(whole, final, named, band, report, small=len(absorbed))
    final, named = run_off(whole, final, named, band, report)
    final, named = as_one_gain(
        *(whole, *on_a_light_load(whole, final, named, band, report), candidates, band),
        believed=model,
    )
    final, named = without_stand_ins(whole, *without_idle(whole, final, named, band), band)
    plain = seek(whole, base.model, base.unknowns, iterations=1, first=2)
    before = misfit(whole, plain.errors)
    late = Late(quick, whole, candidates, scales, band, report)
    noted = [
        n
        for n in named
        if is_noted(n.effect, before, final.model) and worth_a_name(n, final, scales)
    ]
    longer = longer_look(recordings, plain.model, block)
    joint = _beside_coasting(late, longer, (plain, final), noted, rounds)
    if joint is not None:
        (final, named), absorbed = joint, []
    if not named:  # a line of its error may repeat with the shaft by chance
        final = _coasting_or_not(late, final, plain)
    one = asked_late(late, final, named, unsure(failed))
    if one is not None:
        rounds.append(one.round)
        final, named = fit_jointly(whole, one.contender.found, [*named, one], band, report)
        absorbed = [effect for effect in absorbed if effect != one.effect]
    final, named, small = _worth_telling(late, final, named, before, anew=bool(joint or one))
    absorbed += small
    # judged beside what is known now: a motor that sticks stands on the command's own steps
    grid = None if "quantisation" in out else lattice(whole.fitted[0], final.model)
    final, plain, named, absorbed = _coasting_at_last(late, final, plain, named, absorbed)
    final, named, readings = with_readings(whole, final, named, late, out)
    there = {*_absorbed(absorbed, named, final), *(read.effect for read in readings)}
    named = beside_the_unlike(final, named, late, there=there)
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
        absorbed=_absorbed(absorbed, named, final),
        lost=lost,
        lattice=grid,
        readings=readings,
        motor_lines=motor.torque,
        load_lines=load,
        tone=tone(whole.fitted[0], final.model) or tone(quick.fitted[0], now.model),
        creep=creep(whole.fitted[0], final.model),
        wild=_wild(came, whole, final.model, scales),
        turns=turns,
        rounds=tuple(rounds),
        doubts=doubts(whole, final, named, band, {h.effect for h in candidates}),
        misfit_before=before,
        misfit_after=misfit(whole, final.errors, _beside(whole, final.model, scales, grid)),
        notes=(*ready.notes, *_of_the_rows(came, rows), *_of_words(came, model)),
        narrowed=bool(without or only),
        seconds=time.perf_counter() - began,
    )


def _not_asked(without: Collection[str], only: Collection[str]) -> set[str]:
    """Of what is seen in the data themselves, what nobody wants to be told."""
    return {e for e in (*READ_OFF, *DETECTED) if e in without or (only and e not in only)}


def _beside_coasting(
    late: Late,
    longer: Evidence,
    ends: tuple[Found, Found],
    noted: Sequence[Named],
    rounds: list[Round],
) -> tuple[Found, list[Named]] | None:
    """What is there beside a load that coasts, where nothing was found without that; or where what
    was found gives the load a motion of its own and fits worse, which its encoder alone does not
    tell from the motor's."""
    plain, final = ends
    moves = late.whole.is_of_the_load_alone and any(n.effect in OTHERWISE for n in noted)
    if noted and not moves:
        return None
    joint = asked_again(late, longer, plain, final, rounds.append)
    if not moves:
        return joint
    coasts, named = joint or (with_coasting(late.whole, plain, scouted=late.quick), [])
    better = coasts.errors.cost(plain.sigma) < final.errors.cost(plain.sigma)
    return (coasts, named) if better and is_coasting(coasts.model) else None


def _coasting_or_not(late: Late, final: Found, plain: Found) -> Found:
    """The final fit beside a load that coasts. What was too small for a name may have stood in for
    it, and given the load a motion of its own: the better of the two."""
    if not OTHERWISE & final.model.effects.keys():
        return with_coasting(late.whole, final, scouted=late.quick)
    coasts = with_coasting(late.whole, plain, scouted=late.quick)
    better = coasts.errors.cost(final.sigma) < final.errors.cost(final.sigma)
    return coasts if better and is_coasting(coasts.model) else final


def _coasting_at_last(
    late: Late, final: Found, plain: Found, named: list[Named], absorbed: list[str]
) -> tuple[Found, Found, list[Named], list[str]]:
    """The final fit, the plain one, causes, and what is too small for a name, with a load that
    coasts where that is so: where nothing was found the fits are the same, and what coasting was
    asked with is not sought once more. A coupling faces its rivals there.
    """
    nothing = not (named or absorbed)
    if nothing and is_coasting(final.model):
        final = coasting_or_rested(late.whole, final, plain)
    else:
        rested = plain if nothing else final
        final = with_coasting(late.whole, rested, to_ask=False, scouted=late.quick)
    final, named, small = couplings_again(late, final, named)
    return final, final if nothing else plain, named, [*absorbed, *small]


def _worth_telling(
    late: Late, final: Found, named: list[Named], before: Array, *, anew: bool
) -> tuple[Found, list[Named], list[str]]:
    """The final fit, its causes that are worth a name, with what they need beside them, and effects
    that are too small for one. Where it was made `anew`, what may have stood in for others is
    looked at once more."""
    scales = late.scales
    if not is_coasting(final.model):  # its contact is no vehicle that a cause was tried on
        vehicle = needed_vehicle(late.whole, final, named, late.band, late.report)
        named = [*named, *vehicle]
    if anew:
        final, named = without_idle(late.whole, final, named, late.band)
        final, named = without_stand_ins(late.whole, final, named, late.band)
    coasts = is_coasting(final.model)  # what is left beside that is hardly anything else
    wrong = {n.effect for n in named if coasts or is_noted(n.effect, before, final.model)}
    noted = [n for n in named if n.effect in wrong]
    small = [n.effect for n in named if n.effect not in wrong]
    right = float(before.max()) < RIGHT_ALREADY
    small += [n.effect for n in noted if not is_worth_it(n, final, scales, right=right)]
    named = [n for one in noted for n in worth_a_name(one, final, scales, right=right)]
    return final, named, small


def _absorbed(effects: Sequence[str], named: Sequence[Named], final: Found) -> tuple[str, ...]:
    """Of what was too small for a name, what is neither named after all nor told as coasting."""
    told = {n.effect for n in named} | (OTHERWISE if is_coasting(final.model) else set())
    return tuple(effect for effect in effects if effect not in told)


def _beside(whole: Evidence, model: Model, scales: Scales, grid: Lattice | None) -> Array:
    """What this very model may miss beside what every right one may, in the signals' units."""
    beside = (
        bounces(whole, model),
        unevenness(whole, model, scales.rig_torque_nm),
        ticks(whole, model),
        rounding(whole, grid.quantum_rad if grid is not None else 0.0),
        scatter(whole, model),
    )
    return np.asarray(np.linalg.norm(beside, axis=0))


def _need_command(recordings: Sequence[Recording]) -> None:
    if any("velocity_command_rad_s" not in recording for recording in recordings):
        raise FitError(
            "a recording has no velocity command: the closed loop cannot be played from it. Record "
            "the command, or give measured data with current or voltage and motion alone."
        )


def _thinned(
    recordings: Sequence[Recording], held_out: Recording | None, rows: int, model: Model
) -> tuple[tuple[Recording, ...], Recording | None]:
    """One row kept of so many, and no word that the line spoilt."""
    gap_rad = model.nominal.backlash_gap_rad
    every = [*recordings, *([held_out] if held_out is not None else [])]
    kept = [thinned(without_spoilt_words(one, gap_rad), rows) for one in every]
    judge = kept.pop() if held_out is not None else None
    return tuple(kept), judge


def _of_the_rows(came: Recording, rows: int) -> tuple[str, ...]:
    if rows == 1:
        return ()
    return (
        f"Commands lasted for {rows} rows or multiples of them: of so many one was judged, every "
        f"{rows * came.period_s * 1e3:g} ms.",
    )


def _of_words(came: Recording, model: Model) -> tuple[str, ...]:
    """How many words the line spoilt in the first recording, where it did."""
    spoilt = spoilt_words(came, model.nominal.backlash_gap_rad)
    if not spoilt:
        return ()
    return (
        f"{spoilt} {'angle is' if spoilt == 1 else 'angles are'} what no motion of this rig is, "
        "and right again in the next rows: passed over. Look at the encoder's line.",
    )


def _wild(came: Recording, whole: Evidence, model: Model, scales: Scales) -> int:
    """Wrong samples, of all the rows that came."""
    seen = whole.fitted[0]
    kept = without_spoilt_words(came, scales.gap_rad)
    if 1.5 * came.period_s < seen.source.rows.period_s:
        seen = compare(kept, model, seen.block, scales=SCALES)
    return wild_samples(seen, model, scales.gap_rad) + spoilt_words(came, scales.gap_rad, [LOAD])
