"""Motors that a position loop holds: which effects bring the simulated motion to the measured one.

A regression of the acceleration sees next to nothing where a motor creeps and sticks. The loop's
commands are known, so the whole run is played (see `driven`) and the motion itself is compared: the
angle, and its increments over one, six and thirty-six rows.

    start    inertia, torque per volt, viscous drag, which back-EMF is a part of; dry friction; and,
             where the map's plant has one, a pendulum
    rounds   every other effect between volts and motion is tried against the rest (see `rounds`)
    at last  all but inertia, torque and drag is taken away once; what is not missed goes
    held     the last quarter of every recording, which no fit saw; a recording that is held out
             takes no part but in the gain

Without its weight and its friction a pendulum's loop is so far from what was measured that nothing
can be told apart: hence both are there from the beginning, free, and must prove themselves at the
end. The scale of torque is that of the inertia.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.evidence import Evidence, block_z
from servo_bench.diagnosis.comparing.rows import Array, Mask
from servo_bench.diagnosis.elsewhere.shown import Shown
from servo_bench.diagnosis.fitting.driven import DrivenComparison, compare_driven, resistance_ohm
from servo_bench.diagnosis.fitting.foreign_start import starting_model
from servo_bench.diagnosis.searching.contenders import Round
from servo_bench.diagnosis.searching.hypotheses import Hypothesis, hypotheses
from servo_bench.diagnosis.searching.joint import Named, own_unknowns, without_effect
from servo_bench.diagnosis.searching.rounds import play_round
from servo_bench.diagnosis.searching.scales import Scales
from servo_bench.diagnosis.searching.seeking import Found, seek, settle
from servo_bench.diagnosis.searching.unknowns import Unknown
from servo_bench.errors import FitError
from servo_bench.recording.recording import Recording
from sim_rig.model import Model

SCALES = (1, 6, 36)
MOST_ROUNDS, STARTS = 5, 3
WEIGHT, FRICTION = "gravity_imbalance", "coulomb"
TRIED = frozenset(
    {
        *("stribeck", "load_dependent_friction", "asymmetric_friction"),
        *("load_torque", "position_friction", "transport_delay", WEIGHT),
    }
)
"""What a position loop's motion can tell, beside dry friction."""
SEEN_Z, HELD_Z, HELD_GAIN = 4.0, 0.0, 0.1
"""Runs of some seconds leave few blocks that no fit saw: the share that goes there must be large.

Set on the one data set of tests/test_diagnose_realdata.py, so that does not prove them.
"""
NEEDED_SHARE = 0.01


@dataclass(frozen=True)
class LoopedFinding:
    """What a verdict is written from. `before` and `after`: rms of the held-out angle's error,
    `there` of that angle about its mean, rad.

    `missed_z`: by how much, in block scatter, weight and dry friction are missed where they are.
    """

    plain: Found
    final: Found
    named: tuple[Named, ...]
    missed_z: Mapping[str, float]
    scales: Scales
    before: float
    after: float
    there: float
    floor: float
    left_out: int
    shown: Shown


def judge_looped(
    recordings: Sequence[Recording],
    held_out: Recording | None = None,
    *,
    without: Collection[str] = (),
    only: Collection[str] = (),
) -> LoopedFinding:
    """Raises FitError where no recording has the loop closed from its beginning to its end."""
    closed = [recording for recording in recordings if _powered(recording)]
    if not closed:
        raise FitError(
            "the loop was open for a part of every recording: what the motor does then is not "
            "commanded. Record runs with the power stage on throughout."
        )
    starts, evidence = _started(closed)
    begun, scales = _begun(evidence, closed, starts)
    judging = evidence if held_out is None else _evidence([held_out], begun.model, closed[0])
    there = {u.effect for u in begun.unknowns} & {WEIGHT, FRICTION}
    tried = (TRIED & set(only) if only else TRIED) - there
    candidates = hypotheses(scales, without=tuple(without), only=tuple(sorted(tried)))
    now, named = _rounds(evidence, begun, candidates if tried else ())
    final, kept = _needed(evidence, now, named)
    missed_z, final = _proven(evidence, final, sorted(there - set(without)))
    bare = begun.model.without(WEIGHT, FRICTION)
    plain = seek(evidence, bare, _plain(bare), final.sigma, iterations=6)
    whole = held_out is not None
    return LoopedFinding(
        plain=plain,
        final=final,
        named=tuple(kept),
        missed_z=missed_z,
        scales=scales,
        before=_angle_rms(judging, plain.model, whole=whole),
        after=_angle_rms(judging, final.model, whole=whole),
        there=_turned_rms(judging, whole=whole),
        floor=float(evidence.floors[_angle(evidence)]),
        left_out=len(recordings) - len(closed),
        shown=_shown(judging, plain.model, final.model, whole=whole),
    )


def _powered(recording: Recording) -> bool:
    switches = [values for name, values in recording.channels.items() if "enable" in name]
    return all(bool((values != 0).all()) for values in switches)


def _started(closed: Sequence[Recording]) -> tuple[list[Model], Evidence]:
    """What every recording alone would start from, what plays all of them best first."""
    starts = []
    for recording in closed:
        try:
            starts.append(starting_model(recording))
        except FitError:
            continue
    if not starts:
        starting_model(closed[0])
    evidence = _evidence(closed, starts[0], closed[0])
    told = [_with_friction(model) for model in starts]
    costs = [errors.cost(evidence.floors) for errors in evidence.seen(told)]
    return [starts[k] for k in np.argsort(costs)], evidence


def _begun(
    evidence: Evidence, closed: Sequence[Recording], starts: Sequence[Model]
) -> tuple[Found, Scales]:
    """The best search of those from the most promising starts: an inertia is no free number."""
    found: list[tuple[Found, Scales]] = []
    for start in starts[:STARTS]:
        scales = _scales(closed, start)
        free = (*_plain(start), *_weight(start), *_friction(scales))
        begun = seek(evidence, start, free, evidence.floors, iterations=6, coarse=False)
        found.append((begun, scales))
    best, scales = min(found, key=lambda pair: pair[0].cost)
    return seek(evidence, best.model, best.unknowns, iterations=3, first=1, coarse=False), scales


def _with_friction(model: Model) -> Model:
    """A start is tried with some friction, as every motor has."""
    weight = model.effects.get(WEIGHT)
    if weight is None:
        return model
    return model.with_effect(FRICTION, torque_nm=0.1 * float(weight.torque_nm))


def _evidence(recordings: Sequence[Recording], model: Model, first: Recording) -> Evidence:
    fitted: tuple[Comparison, ...] = tuple(_comparison(r, model, first) for r in recordings)
    return Evidence(fitted, fitted)


def _comparison(recording: Recording, model: Model, first: Recording) -> DrivenComparison:
    """Seen through its own loop: gains differ between recordings of one motor. What lies behind the
    motor is left out."""
    kept = {name: v for name, v in recording.channels.items() if name != "load_angle_rad"}
    motor = replace(recording, channels=kept)
    made = compare_driven(motor, model, "loop", None, scales=SCALES)
    return replace(made, view=_through(made.view, _gain(recording) / _gain(first)))


def _gain(recording: Recording) -> float:
    loop = recording.plant.position_loop if recording.plant else None
    return (loop.proportional_gain_v_per_rad if loop else 1.0) / resistance_ohm(recording)


def _through(view: Callable[[Model], Model], ratio: float) -> Callable[[Model], Model]:
    def seen(model: Model) -> Model:
        shown = view(model)
        gain = shown.nominal.integral_gain_a_per_rad * ratio
        part = shown.nominal.proportional_gain_a_s_per_rad * ratio
        nominal = replace(
            shown.nominal, integral_gain_a_per_rad=gain, proportional_gain_a_s_per_rad=part
        )
        return replace(shown, nominal=nominal)

    return seen


def _plain(start: Model) -> tuple[Unknown, ...]:
    """Torque per volt and drag; the inertia is the scale."""
    drag = start.effects.get("viscous")
    size = float(drag.damping_nm_s_per_rad) if drag is not None else 0.0
    nominal = start.nominal
    size = size or 0.1 * nominal.torque_constant_nm_per_a
    return (
        Unknown("torque_constant_error", "error_fraction", -0.9, 9.0, step=0.2),
        Unknown("viscous", "damping_nm_s_per_rad", 0.0, 100.0 * size, step=0.3 * size),
    )


def _weight(start: Model) -> tuple[Unknown, ...]:
    """The pendulum's, where there is one: the map tells about how heavy it is."""
    params = start.effects.get(WEIGHT)
    if params is None:
        return ()
    told = float(params.torque_nm)
    return (
        Unknown(WEIGHT, "torque_nm", 0.0, 5.0 * told, step=0.2 * told),
        Unknown(WEIGHT, "phase_rad", -np.inf, np.inf, step=0.1, circular=True),
    )


def _friction(scales: Scales) -> tuple[Unknown, ...]:
    torque = scales.torque_nm
    return (
        Unknown(FRICTION, "torque_nm", 0.0, 2.0 * torque, step=0.1 * torque),
        Unknown(FRICTION, "transition_rad_s", 0.02, 2.0, step=0.2),
    )


def _scales(recordings: Sequence[Recording], start: Model) -> Scales:
    """How large things are: the torque that the loop asked, the speed that came of it."""
    effort, speed = [], []
    for recording in recordings:
        angle = np.asarray(recording["motor_position_rad"], np.float64)
        off = np.asarray(recording["position_command_rad"], np.float64) - angle
        effort.append(_gain(recording) * off)
        speed.append(np.gradient(angle, np.asarray(recording["t_s"], np.float64)))
    current = float(np.sqrt(np.nanmean(np.concatenate(effort) ** 2)))
    fast = float(np.sqrt(np.nanmean(np.concatenate(speed) ** 2)))
    nominal = start.nominal
    return Scales(
        torque_nm=current * nominal.torque_constant_nm_per_a,
        speed_rad_s=fast,
        current_a=current,
        currents_a=(2.0 * current, 1.5 * current, current),
        integral_a=(2.0 * current, 1.5 * current, current),
        command_rad_s=3.0 * fast,
        jump_rad_s=fast,
        gap_rad=0.0,
        inertia_kg_m2=nominal.inertia_kg_m2,
    )


def _rounds(
    evidence: Evidence, base: Found, candidates: Sequence[Hypothesis]
) -> tuple[Found, list[Named]]:
    named: list[Named] = []
    for _ in range(MOST_ROUNDS):
        left = [h for h in candidates if h.effect not in {n.effect for n in named}]
        if not left:
            break
        played = play_round(evidence, base, left, {}, _nothing)
        best = _accepted(played)
        if best is None:
            break
        named.append(best)
        base = best.contender.found
    return base, named


def _nothing(_: str) -> None:
    """Progress that nobody asked for."""


def _accepted(played: Round) -> Named | None:
    for best in played.contenders[:1]:
        if best.seen_z > SEEN_Z and best.held_z > HELD_Z and best.held_gain > HELD_GAIN:
            return Named(best.effect, played, best, own_unknowns(best, best.effect))
    return None


def _needed(evidence: Evidence, now: Found, named: list[Named]) -> tuple[Found, list[Named]]:
    """Everything together, in fine steps; what seen and held-out costs do not miss goes."""
    final = seek(evidence, now.model, now.unknowns, now.sigma, iterations=3, first=2, coarse=False)
    final = settle(evidence, final, {n.effect for n in named}, turns=2, coarse=False)
    kept = list(named)
    for one in named:
        less = without_effect(evidence, final, one.effect, ())
        if not _is_missed(evidence, final, less):
            kept.remove(one)
            final = less
    return final, kept


def _proven(
    evidence: Evidence, final: Found, effects: Sequence[str]
) -> tuple[dict[str, float], Found]:
    """By how much what was there from the beginning is missed; what is not is taken out."""
    missed_z: dict[str, float] = {}
    for effect in effects:
        less = without_effect(evidence, final, effect, ())
        if _is_missed(evidence, final, less):
            advantage = block_z(final.errors.costs(final.sigma), less.errors.costs(final.sigma))
            missed_z[effect] = advantage
        else:
            final = less
    return missed_z, final


def _is_missed(evidence: Evidence, final: Found, less: Found) -> bool:
    more = [final.errors, *evidence.held_out([final.model], coarse=False)]
    gone = [less.errors, *evidence.held_out([less.model], coarse=False)]
    costs = [sum(e.cost(final.sigma) for e in errors) for errors in (more, gone)]
    held = gone[1].cost(final.sigma) > more[1].cost(final.sigma)
    return held and costs[0] < (1.0 - NEEDED_SHARE) * costs[1]


def _angle(evidence: Evidence) -> int:
    return evidence.names.index("motor angle")


def _judged(comparison: Comparison, *, whole: bool) -> Mask:
    """Where no fit saw it."""
    return comparison.seen | comparison.held_out if whole else comparison.held_out


def _shown(evidence: Evidence, plain: Model, final: Model, *, whole: bool) -> Shown:
    """The motor's angle in time, of the first recording that judges."""
    k, comparison = _angle(evidence), evidence.judging[0]
    errors = [comparison.errors(model)[k] for model in (plain, final)]
    start = np.concatenate([piece.start for piece in comparison.pieces])
    where = _judged(comparison, whole=whole) & np.isfinite(errors[0]) & np.isfinite(errors[1])
    time_s = comparison.source.rows.t_s[start][where]
    measured = comparison.measured[k][where]
    models = (measured - error[where] for error in errors)
    return Shown("motor angle", "rad", "time", "s", time_s, time_s, measured, *models)


def _angle_rms(evidence: Evidence, model: Model, *, whole: bool) -> float:
    """Of the motor's angle where no fit saw it."""
    k = _angle(evidence)
    return _rms([c.errors(model)[k][_judged(c, whole=whole)] for c in evidence.judging])


def _turned_rms(evidence: Evidence, *, whole: bool) -> float:
    """Of that angle itself, each recording's about its mean."""
    k = _angle(evidence)
    shown = [c.measured[k][_judged(c, whole=whole)] for c in evidence.judging]
    return _rms([angle - np.nanmean(angle) for angle in shown if np.isfinite(angle).any()])


def _rms(parts: Sequence[Array]) -> float:
    """Of all that came."""
    every = np.concatenate([part[np.isfinite(part)] for part in parts] or [np.zeros(1)])
    return float(np.sqrt(np.mean(every**2))) if every.size else 0.0
