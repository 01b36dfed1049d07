"""From findings to a verdict: named, none, or unknown, and how sure.

    named     every accepted cause survived, and what is left is what a right simulation may miss
    unknown   more is left than that; or what was found cannot be (a torque line at no whole order);
              or something stands in the data that no effect makes (a tone, creep, wild samples,
              an angle that stands still or jumps);
              or a cause is not as large at the recording's end as it was at its beginning;
              or it is not missed where what every rig has may be more (`letting_go`)
    none      neither

What is told of each cause is in `causes`.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from servo_bench.diagnosis.comparing.rows import Mask
from servo_bench.diagnosis.fitting.free import unit_of
from servo_bench.diagnosis.judging.broken import Rig, broken
from servo_bench.diagnosis.judging.causes import causes_of
from servo_bench.diagnosis.judging.gain import error_figures
from servo_bench.diagnosis.judging.intervals import limits_of, names_of
from servo_bench.diagnosis.judging.sensors import misread
from servo_bench.diagnosis.judging.steadiness import CHANGES, slope_of
from servo_bench.diagnosis.judging.undecided import (
    without_the_load_s_angle,
    without_the_motor_s_angle,
)
from servo_bench.diagnosis.judging.verdict import (
    Cause,
    ErrorFigures,
    Kind,
    Verdict,
)
from servo_bench.diagnosis.searching.coasting import given_back, is_coasting, slowing_rad_s2
from servo_bench.diagnosis.searching.finding import Finding
from servo_bench.diagnosis.searching.gate import RIGHT, RIGHT_ALREADY, strength_of
from servo_bench.diagnosis.searching.hypotheses import DETECTED, ON_THE_LOAD
from servo_bench.diagnosis.searching.readying import order_tolerance
from servo_bench.diagnosis.searching.seeking import Found
from sim_rig.effects import find_effect
from sim_rig.model import Model

FAR_BETTER, NEARLY_RIGHT, BEST_LAW = 10.0, 2.5, 30.0
"""So many times better than before, and so near, is explained too where it is the load's, whose
bounces no law foretells: what remains is noted. Of the motor and its torque that near is not
enough: a notch of 25 Hz left 1.12 of 15 there. But no law is exact: of what is far off, a thirtieth
of the largest may be left of any (an anti-windup's drift left 2.1 of 74)."""
THROWN = 1.5
"""That near the motor may be where a torque on the load throws it about: its bounces reach it."""
WORSE = 1.25
"""So many times as wrong as before, and more than a right simulation usually is, is not explained:
a notch in the controller was called a lag and a soft coupling, which put the twist wrong."""
UNSURE = 0.79
"""Confidence up to which a cause has no name: of 201 that were named on development seeds the three
that had less were wrong, and of those that were right none had."""
FEWEST_WILD = 3


def verdict_of(finding: Finding) -> Verdict:
    """The verdict, without words on the signature."""
    strange = tuple(_strange(finding))
    told = tuple(causes_of(finding))
    causes = tuple(c for c in told if _has_a_name(c))
    explained = (_explained(finding) if causes or not told else _is_right(finding)) and not strange
    kind: Kind = "named" if causes and explained else "none" if explained else "unknown"
    named = causes if kind == "named" else ()
    notes = [*finding.notes, *_absorbed(finding), *_coasting(finding.final.model)]
    if kind == "unknown" and told:
        do = "does" if len(told) == 1 else "do"
        notes.append(
            f"It resembles {', '.join(c.effect for c in told)}, which {do} not explain it."
        )
    elif len(causes) < len(told):
        names = ", ".join(c.effect for c in told if c not in causes)
        notes.append(f"{names} would take a part of what is left, not surely enough for a name.")
    if kind == "unknown":
        notes += misread(finding.whole.fitted[0], finding.nominal, finding.final.model)
    fitted = fitted_of(finding, told)
    model = fitted.model
    error = error_figures(finding, model, [c.effect for c in named])
    return Verdict(
        verdict=kind,
        sentence=_sentence(kind, named, strange, error, told, finding=finding),
        causes=named,
        error=error,
        limit=tuple(limits_of(finding, named)),
        notes=tuple(notes) + strange,
        undecided=tuple(_undecided(finding)),
        next_run=next((c.splitting_experiment for c in named if c.splitting_experiment), ""),
        nominal=_nominal(model),
        effects=_effects(model, named),
        nuisances=_nuisances(finding, fitted),
        seconds=finding.seconds,
    )


def fitted_of(finding: Finding, told: Sequence[Cause]) -> Found:
    """Which of its fits a verdict and its page tell: the final one, with all that is too small for
    a name; but the plain one where it has what is not sure enough to be believed."""
    unsure = told and not any(_has_a_name(cause) for cause in told)
    return finding.base if unsure else finding.final


def _has_a_name(cause: Cause) -> bool:
    """Whether it is sure enough; or in doubt with a rival that the verdict names beside it."""
    return cause.confidence > UNSURE or cause.rival in cause.ambiguous_with


def _strange(finding: Finding) -> Iterator[str]:
    """What no effect of the catalogue makes, in sentences."""
    yield from broken(finding.recordings, finding.held_out, _rig_of(finding))
    if finding.tone is not None:
        rate_hz = 1.0 / finding.recordings[0].period_s
        yield (
            f"A tone of {finding.tone.frequency_hz:.2f} Hz, or so much beside a multiple of "
            f"{rate_hz:.4g} Hz, stands in the load's error, {finding.tone.amplitude_rad:.2g} rad: "
            "it comes from outside of the rig's own motion."
        )
    if finding.creep is not None:
        yield (
            "The load's angle gives way to the motor's torque slowly: "
            f"{finding.creep.rate_rad_s_per_nm:.2g} rad/s for each N m, for some "
            f"{finding.creep.time_s:.1g} s, {finding.creep.rms_rad:.2g} rad rms. An encoder's "
            "bracket, glue, or rubber creeps so; look at what holds it."
        )
    if finding.wild >= FEWEST_WILD:
        yield (
            f"{finding.wild} load samples are wrong, alone or a few in a row, by more than any "
            "state of the gap allows: look at the encoder's line."
        )
    for effect in {n.effect for n in finding.named} & {"cogging", "torque_ripple"}:
        order = _order(finding.final.model, effect)
        if abs(order - round(order)) > order_tolerance(finding.turns):
            yield (
                f"A torque line stands at {order:.2f} periods a revolution of the motor: no whole "
                "number, so nothing on the motor's own shaft makes it (a gear's mesh would)."
            )
    yield from _unsteady(finding)
    for doubt in finding.doubts:
        more = " or ".join(effect.replace("_", " ") for effect in doubt.instead)
        yield (
            f"{doubt.effect.replace('_', ' ').capitalize()} takes the place of what was not asked "
            f"as a cause: it is not missed beside more {more} than every rig has."
        )


def _rig_of(finding: Finding) -> Rig:
    nominal = finding.nominal.nominal
    stiff = nominal.torque_constant_nm_per_a * nominal.integral_gain_a_per_rad
    held_rad = finding.scales.rig_torque_nm / stiff if stiff > 0.0 else np.inf
    stands_rad_s = strength_of(finding.final.model, "command_deadband")
    return Rig(nominal.backlash_gap_rad, stands_rad_s, held_rad)


def _unsteady(finding: Finding) -> Iterator[str]:
    """Causes whose size changes while it is recorded, in sentences."""
    for effect in dict.fromkeys(n.effect for n in finding.named):
        strength = find_effect(effect).strengths[0]
        name = f"{effect}.{strength}"
        if effect in CHANGES or name not in names_of(finding.final):
            continue
        slope = slope_of(finding.final, name)
        if slope.is_there:
            yield (
                f"What looks like {effect.replace('_', ' ')} changes while it is recorded: "
                f"{strength} goes from {slope.first:.2g} to {slope.last:.2g} {unit_of(strength)}, "
                f"which takes another {100.0 * slope.taken:.0f} % of the error. Something warms, "
                "wears, or works loose."
            )


def _order(model: Model, effect: str) -> float:
    params = model.effects[effect]
    if effect == "cogging":
        return float(params.order)
    return float(params.electrical_order * params.pole_pair_count)


def _is_right(finding: Finding) -> bool:
    """Whether the simulation misses no more than it may without any cause."""
    return float(finding.misfit_before.max()) <= RIGHT


def _explained(finding: Finding) -> bool:
    """Whether what is left is what a right simulation may miss."""
    if _worse(finding).any():
        return False
    after, before = finding.misfit_after, finding.misfit_before
    if after.max() <= RIGHT:
        return True
    of_the_load = [name.startswith(("twist", "load")) for name in finding.whole.names]
    thrown = bool({n.effect for n in finding.named} & ON_THE_LOAD)
    of_the_motor = THROWN if thrown else RIGHT
    near = np.maximum(np.where(of_the_load, NEARLY_RIGHT, of_the_motor), before.max() / BEST_LAW)
    return bool(before.max() > FAR_BETTER * after.max() and (after <= near).all())


def _worse(finding: Finding) -> Mask:
    """Signals that the causes have made more wrong, shape (signals,): who stands in for something
    else pays for what he takes elsewhere."""
    after, before = finding.misfit_after, finding.misfit_before
    return np.asarray((after > RIGHT_ALREADY) & (after > WORSE * before))


def _absorbed(finding: Finding) -> Iterator[str]:
    for effect in dict.fromkeys(finding.absorbed):
        strength = find_effect(effect).strengths[0]
        params = finding.final.model.effects.get(effect)
        if params is not None:
            value = float(getattr(params, strength))
            believed = finding.nominal.effects.get(effect)
            had = "" if believed is None else f" (its file has {getattr(believed, strength):.2g})"
            unit = "" if unit_of(strength) == "1" else f" {unit_of(strength)}"
            yield (
                f"{effect.replace('_', ' ')} is there too, {value:.2g}{unit}{had}: "
                "too small on this rig to be worth a name."
            )


def _coasting(model: Model) -> Iterator[str]:
    if is_coasting(model):
        yield (
            "The load goes on in its gap when the motor turns back, slowed by "
            f"{slowing_rad_s2(model):.2g} rad/s2, and leaves a face that it met with 1 rad/s with "
            f"{100.0 * given_back(model, 1.0):.0f} % of that: no drawing tells it, and every light "
            "load does."
        )


def _undecided(finding: Finding) -> Iterator[str]:
    first = finding.recordings[0]
    yield from without_the_motor_s_angle(first)
    yield from without_the_load_s_angle(first)


def _nominal(model: Model) -> dict[str, float]:
    nominal = model.nominal
    return {name: float(getattr(nominal, name)) for name in nominal.__dataclass_fields__}


def _effects(model: Model, named: Sequence[Cause]) -> dict[str, dict[str, float]]:
    """What the extended rig has: the fitted model's effects, and those that no fit has, because
    they stand in the data itself (a lattice, commands that were lost)."""
    found = {name: dict(table) for name, table in model.to_table().items() if table}
    for cause in named:
        if cause.effect in DETECTED:
            found[cause.effect] = {name: q.value for name, q in cause.parameters.items()}
    return found


def _nuisances(finding: Finding, fitted: Found) -> dict[str, float]:
    named = {n.effect for n in finding.named}
    return {
        u.name: float(v)
        for u, v in zip(fitted.unknowns, fitted.values, strict=True)
        if u.effect not in named
    }


def _sentence(
    kind: str,
    named: Sequence[Cause],
    strange: Sequence[str],
    error: ErrorFigures | None,
    tried: Sequence[Cause],
    *,
    finding: Finding,
) -> str:
    gain = ""
    if error is not None and kind == "named":
        gain = (
            " With it the simulation's error on data that no fit saw falls from "
            f"{error.before:.3g} to {error.after:.3g} {error.unit}, "
            f"{100 * error.share_explained:.0f} % of what can be explained"
        )
        if error.without_causes is not None:
            gain += (
                f"; with what every rig has beside its drawing alone, to {error.without_causes:.3g}"
            )
        gain += "."
    if kind == "named":
        told = " and ".join(_told(c, finding.nominal) for c in named)
        return f"The simulation lacks {told}.{gain}"
    if kind == "none":
        return (
            "Nothing is wrong with the simulation beyond what every rig has beside its drawing: no "
            "effect of the catalogue is needed."
        )
    if strange:
        return f"Something is wrong that the catalogue does not have. {strange[0]}"
    like = f" It comes nearest to {tried[0].effect}." if tried else ""
    asked = "effect that was asked" if finding.narrowed else "effect of the catalogue"
    return (
        f"The simulation is wrong by more than its usual floor, and no {asked} explains it.{like}"
    )


def _told(cause: Cause, nominal: Model) -> str:
    strength = find_effect(cause.effect).strengths[0]
    believed = nominal.effects.get(cause.effect)
    quantity = cause.parameters.get(strength)
    size = ""
    if quantity is not None:
        unit = f" {quantity.unit}" if quantity.unit != "1" else ""
        had = "" if believed is None else f"; its file has {getattr(believed, strength):.3g}{unit}"
        size = f" ({quantity.value:.3g} ± {1.96 * quantity.standard_error:.1g}{unit}{had})"
    others = f", or {' or '.join(cause.ambiguous_with)}" if cause.ambiguous_with else ""
    return f"{cause.effect.replace('_', ' ')}{size}{others.replace('_', ' ')}"
