"""The verdict on effort and motion, in words and in the public schema."""

from collections.abc import Iterator, Sequence

import numpy as np

from servo_bench.diagnosis.elsewhere import gate
from servo_bench.diagnosis.elsewhere.equation import error_of, offset_of, size_of
from servo_bench.diagnosis.elsewhere.explained import EXPLAINED
from servo_bench.diagnosis.elsewhere.mechanics import MechanicsFinding, signal_of
from servo_bench.diagnosis.elsewhere.selection import Step
from servo_bench.diagnosis.fitting.free import unit_of
from servo_bench.diagnosis.judging.verdict import Cause, ErrorFigures, Quantity, Verdict
from servo_bench.diagnosis.searching.classes import class_of, splitting


def mechanics_verdict(found: MechanicsFinding) -> Verdict:
    """Named causes with sizes, or none with the reason."""
    quiet = found.quiet
    causes = () if quiet else tuple(_causes(found))
    explainable = found.before**2 - found.floor**2
    share = (found.before**2 - found.after**2) / explainable if explainable > 0.0 else 0.0
    error = ErrorFigures(
        before=found.before,
        after=found.before if quiet else found.after,
        noise_floor=found.floor,
        share_explained=0.0 if quiet else float(np.clip(share, 0.0, 1.0)),
        signal=_signal(found),
        unit=signal_of(found.effort)[1] if found.inverse else "rad/s2",
    )
    split = next((c.splitting_experiment for c in causes if c.splitting_experiment), "")
    return Verdict(
        verdict="named" if causes else "unknown" if quiet or _is_lost(found) else "none",
        sentence=_of_the_noise(found) if quiet else _sentence(found, causes, error),
        causes=causes,
        error=error,
        notes=tuple(_notes(found)),
        undecided=_undecided(found, quiet=quiet),
        next_run="Drive it with steps both ways, to the recording's end." if quiet else split,
        effects={c.effect: {n: q.value for n, q in c.parameters.items()} for c in causes},
        nuisances=_nuisances(found),
    )


def _causes(found: MechanicsFinding) -> Iterator[Cause]:
    """One a name; the lines of one effect are its first, second and third strength, by size."""
    steps = found.selected.steps
    for name in dict.fromkeys(step.term.name for step in steps):
        own = [(k, s) for k, s in enumerate(steps) if s.term.name == name]
        parameters, _ = _by_size(found, own)
        best = max((s for _, s in own), key=lambda s: s.z)
        there = {s.term.name for s in steps}
        rivals = [(n, z) for n, z in best.rivals if n not in there]
        near = {n for n, z in rivals if z < gate.HELD_Z} | (class_of(name) - {name})
        over = [(n, z) for n, z in rivals if n not in near]
        rival = min(over, key=lambda one: one[1]) if over else None
        yield Cause(
            effect=name,
            parameters=parameters,
            confidence=gate.confidence(best.z, rival[1] if rival else gate.SECURE_Z),
            ambiguous_with=tuple(sorted(near)),
            splitting_experiment=splitting({name, *near}) if near else "",
            evidence=best.z,
            rival=rival[0] if rival else None,
            over_rival=rival[1] if rival else None,
        )


def _by_size(
    found: MechanicsFinding, own: Sequence[tuple[int, Step]]
) -> tuple[dict[str, Quantity], list[dict[str, Quantity]]]:
    """Parameters of one effect, its lines the strongest first, and the lines that it has no names
    for, each under the names of a first one."""
    strengths = own[0][1].term.effect.strengths
    first = strengths[0]
    lines = []
    for number, step in own:
        place = step.term.strength.removesuffix(first)
        sizes = _sizes(found, number, step)
        lines.append({name.removeprefix(place): size for name, size in sizes.items()})
    lines.sort(key=lambda line: abs(line[first].value), reverse=True)
    named = {
        strength.removesuffix(first) + name: size
        for strength, line in zip(strengths, lines, strict=False)
        for name, size in line.items()
    }
    return named, lines[len(strengths) :]


def _sizes(found: MechanicsFinding, number: int, step: Step) -> dict[str, Quantity]:
    """Strength (and phase) by the delta method, and the shape that was chosen."""
    term, chosen = step.term, found.selected
    know = (chosen.design, number, chosen.coefficients, found.covariance)
    ratio = chosen.design.in_effort(chosen.coefficients)[chosen.design.owned(number)]
    size, error = size_of(*know)
    factor = term.size or 1.0
    found_sizes = {term.strength: _quantity(found, term.strength, size * factor, error * factor)}
    if term.phase is not None:
        phase = float(np.arctan2(ratio[1], ratio[0]))
        around = np.array([-ratio[1], ratio[0]]) / max(size, 1e-300) ** 2
        found_sizes[term.phase] = _quantity(found, term.phase, phase, error_of(*know, around))
    for name, value in term.shape.items():
        found_sizes[name] = Quantity(
            value=value, unit=unit_of(name), ci95=(value, value), standard_error=0.0
        )
    return found_sizes


def _quantity(found: MechanicsFinding, name: str, value: float, error: float) -> Quantity:
    unit = unit_of(name)
    if unit.startswith("N m"):
        unit = signal_of(found.effort)[1] + unit.removeprefix("N m")
    return Quantity(
        value=value,
        unit=unit,
        ci95=(value - 1.96 * error, value + 1.96 * error),
        standard_error=error,
    )


def _nuisances(found: MechanicsFinding) -> dict[str, float]:
    values = found.selected.design.in_effort(found.selected.coefficients)
    numbers = {"offset_effort": float(values[1]), "velocity_lag_s": found.lag_s}
    if found.voltage:
        numbers["back_emf_v_s_per_rad"] = float(-values[2])
    if values[0] > 2.0 * np.sqrt(found.covariance[0, 0]) or not found.inverse:
        numbers["acceleration_per_effort"] = float(1.0 / values[0])
    return numbers


def _notes(found: MechanicsFinding) -> Iterator[str]:
    signal = _signal(found).removeprefix("motor ").capitalize()
    yield (
        f"{signal} R2 on held-out rows: {found.fit_before:.4f} without any effect, "
        f"{found.fit_after:.4f} with those named."
    )
    if found.inverse:
        yield (
            "The effort went into what resists the motor, and little of it into speed: the effort "
            "was explained by the motion, and the inertia is known by what little it accelerated."
        )
    unit = signal_of(found.effort)[1]
    if unit != "N m":
        yield (
            f"Torques are in units of the effort, {unit}: neither K_T nor J was needed, and only "
            "their ratio shows."
        )
    if found.lag_s:
        yield f"The velocity channel comes {found.lag_s * 1e3:.2g} ms after the position's slope."
    yield from _further_lines(found)
    refused = found.selected.refused
    if refused is not None:
        yield (
            f"The best of what was refused is {refused.term.name}: {100.0 * refused.share:.1f} % "
            f"of the held-out error, z = {refused.z:.1f}."
        )


def _undecided(found: MechanicsFinding, *, quiet: bool) -> tuple[str, ...]:
    if quiet:
        return ("Whatever needs an acceleration to show.",)
    told = tuple(_of_a_constant(found))
    if found.inverse:
        told += ("Whatever goes with the effort itself: K_T, its ripple, friction under load.",)
    return told


def _of_a_constant(found: MechanicsFinding) -> Iterator[str]:
    """Of one as large as a cause would have to be, and as sure."""
    chosen = found.selected
    size, error = offset_of(chosen.design, chosen.coefficients, found.covariance)
    effort = float(np.std(chosen.design.rows.column(lambda s: s.effort)))
    if abs(size) > max(gate.SURE * error, gate.MATERIAL * effort):
        unit = signal_of(found.effort)[1]
        yield (
            f"What the constant {size:.3g} ± {error:.1g} {unit} beside the effort is: its sensor's "
            "offset, a load's torque, or friction that differs by direction."
        )


def _further_lines(found: MechanicsFinding) -> Iterator[str]:
    """Lines beyond those that an effect's parameters have names for."""
    steps = found.selected.steps
    for name in dict.fromkeys(step.term.name for step in steps):
        own = [(k, s) for k, s in enumerate(steps) if s.term.name == name]
        first = own[0][1].term.effect.strengths[0]
        _, more = _by_size(found, own)
        if more:
            told = ", ".join(
                f"{line['order'].value:g} ({line[first].value:.2g} {line[first].unit})"
                for line in more
            )
            yield (
                f"{name.replace('_', ' ').capitalize()} has further lines, weaker than those "
                f"named, at orders {told}."
            )


def _is_lost(found: MechanicsFinding) -> bool:
    """Whether neither a plain motor nor any effect explains what is there."""
    return found.fit_after < EXPLAINED


def _signal(found: MechanicsFinding) -> str:
    """What the errors are of."""
    return signal_of(found.effort)[0] if found.inverse else "motor acceleration"


def _of_the_noise(found: MechanicsFinding) -> str:
    return (
        "Nothing can be decided: on the rows that no fit saw the motor turns so evenly that its "
        f"acceleration (rms {found.moved:.2g} rad/s2) does not rise above its noise "
        f"({found.floor:.2g} rad/s2)."
    )


def _sentence(found: MechanicsFinding, causes: tuple[Cause, ...], error: ErrorFigures) -> str:
    if not causes and _is_lost(found):
        return (
            f"Neither a plain motor nor any effect of the catalogue explains the "
            f"{_signal(found).removeprefix('motor ')} on blocks that no fit saw (R2 "
            f"{found.fit_before:.2f} without any effect)."
        )
    if not causes:
        return (
            f"Nothing pays: inertia, {'back-EMF' if found.voltage else 'torque'} and an offset "
            f"explain {100.0 * found.fit_before:.1f} % of the "
            f"{_signal(found).removeprefix('motor ')}, and no effect of the "
            "catalogue takes a part of the rest on blocks that no fit saw."
        )
    names = ", ".join(c.effect.replace("_", " ") for c in causes)
    return (
        f"The plain motor lacks {names}: its {_signal(found).removeprefix('motor ')} error on data "
        "that no fit saw falls from "
        f"{error.before:.3g} to {error.after:.3g} {error.unit}."
    )
