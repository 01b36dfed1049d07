"""The causes of a finding as a verdict tells them: sizes, confidence, rivals.

What a round has found, what it was tried on, and what stands in the data themselves (commands that
were lost, an encoder's lattice, what was read off). Confidence was calibrated on trials of another
plant.
"""

from collections.abc import Iterator

import numpy as np

from servo_bench.diagnosis.comparing.evidence import block_z
from servo_bench.diagnosis.fitting.free import unit_of
from servo_bench.diagnosis.judging.intervals import names_of, quantities, standard_errors
from servo_bench.diagnosis.judging.verdict import Cause, Quantity
from servo_bench.diagnosis.searching.classes import class_of, splitting
from servo_bench.diagnosis.searching.finding import Finding
from servo_bench.diagnosis.searching.gate import HELD_Z, MOST_OF_IT, WARMS, grows, together
from servo_bench.diagnosis.searching.hypotheses import SPRINGS
from servo_bench.diagnosis.searching.joint import Named
from servo_bench.diagnosis.searching.refining import BRISTLES, PLAIN
from servo_bench.diagnosis.searching.unlike import rivals_of
from sim_rig.effects import find_effect
from sim_rig.model import Model

SURE = 6.0
"""A strength of fewer standard errors is no cause, because a sandwich of few blocks is too sure;
unless what it gains stands that far beyond chance, seen and held out, or both together and neither
little; or is most of all; or warms, which what was held out shows."""
FEWEST_LOST = 1
ANY_BEARING_RAD = 3e-5
"""Up to which every bearing gives way before it slides: tenths of a micrometre. Plain friction of
bearings that bend by 2e-5 rad was named by how it begins alone, four times in five."""
BESIDE_NOTHING = 1.96
"""Standard errors up to which a further line of an effect is none."""


def causes_of(finding: Finding) -> Iterator[Cause]:
    numbers = quantities(finding.final, finding.scales)
    known = dict(zip(names_of(finding.final), standard_errors(finding.final), strict=True))
    there = {*finding.absorbed, *(n.effect for n in finding.named)}
    there |= {reading.effect for reading in finding.readings}
    for one in finding.named:
        name = f"{one.effect}.{find_effect(one.effect).strengths[0]}"
        known_well = name not in known or abs(numbers[name].value) > SURE * known[name]
        if known_well or leaves_no_doubt(one):
            yield _in_its_shape(cause_of(one, numbers, frozenset(there)), finding.final.model)
    if len(finding.lost.rows) >= FEWEST_LOST:
        low, high = finding.lost.interval
        yield Cause(
            effect="missed_samples",
            parameters={
                "miss_probability": Quantity(
                    value=finding.lost.probability,
                    unit="1",
                    ci95=(low, high),
                    standard_error=(high - low) / 3.92,
                )
            },
            confidence=0.97,
        )
    if finding.lattice is not None:
        step, error = finding.lattice.quantum_rad, finding.lattice.standard_error_rad
        yield _seen_in_the_data("quantisation", count_rad=_quantity(step, error))
    for read in finding.readings:
        told = {n: _quantity(read.settings[n], error) for n, error in read.errors.items()}
        yield _in_its_shape(_seen_in_the_data(read.effect, **told), finding.final.model)


def _quantity(value_rad: float, error_rad: float) -> Quantity:
    ci95 = (value_rad - 1.96 * error_rad, value_rad + 1.96 * error_rad)
    return Quantity(value=value_rad, unit="rad", ci95=ci95, standard_error=error_rad)


def _seen_in_the_data(effect: str, **parameters: Quantity) -> Cause:
    """A cause that needs no simulation to be seen."""
    return Cause(effect=effect, parameters=parameters, confidence=0.97)


def leaves_no_doubt(one: Named) -> bool:
    """Whether its own round leaves no doubt; what carried another had none."""
    found = one.contender
    most = min(found.seen_gain, found.held_gain) > MOST_OF_IT
    least_z = min(found.seen_z, found.held_z)
    far = together(found) > np.hypot(SURE, SURE) and one.effect not in SPRINGS
    beyond = least_z > SURE or (least_z > HELD_Z and far)
    grown = one.effect in WARMS and grows(found.seen_z, found.held_z) and found.held_z > SURE
    return one.missed_z is None and (beyond or most or grown)


def carried_cause(effect: str, missed_z: float, numbers: dict[str, Quantity]) -> Cause:
    """A cause that had no round of its own: the joint fit misses it by so much."""
    return Cause(
        effect=effect,
        parameters=_of_effect(effect, numbers),
        confidence=confidence(missed_z, None, 0.0),
        evidence=missed_z,
    )


def cause_of(
    one: Named, numbers: dict[str, Quantity], there: frozenset[str] = frozenset()
) -> Cause:
    """A cause as a verdict tells it, beside its best rival; what is `there` as well is none."""
    if one.missed_z is not None:
        return carried_cause(one.effect, one.missed_z, numbers)
    members = class_of(one.effect) - {one.effect}
    near = {c.effect for c in one.round.near(one.contender)} - {one.effect}
    rival = next(iter(rivals_of(one, there)), None)
    over = block_z(one.contender.costs, rival.costs) if rival is not None else None
    evidence = block_z(one.contender.costs, one.round.base_costs)
    plain = _as_any_bearing(one.effect, numbers) - there
    ambiguous = tuple(sorted(members | (near - there) | one.as_well | plain))
    return Cause(
        effect=one.effect,
        parameters=_of_effect(one.effect, numbers),
        confidence=confidence(evidence, over, _foretold(one)),
        ambiguous_with=ambiguous,
        splitting_experiment=splitting({one.effect, *ambiguous}) if ambiguous else "",
        evidence=evidence,
        rival=rival.effect if rival is not None else None,
        over_rival=over,
    )


def _as_any_bearing(effect: str, numbers: dict[str, Quantity]) -> frozenset[str]:
    """The plain friction that bristles are as well which bend as little as those of any bearing."""
    if effect != BRISTLES:
        return frozenset()
    bends_rad = numbers[f"{BRISTLES}.breakaway_angle_rad"].value
    return frozenset({PLAIN}) if bends_rad < ANY_BEARING_RAD else frozenset()


def _of_effect(effect: str, numbers: dict[str, Quantity]) -> dict[str, Quantity]:
    prefix = f"{effect}."
    return {n.removeprefix(prefix): q for n, q in numbers.items() if n.startswith(prefix)}


def _in_its_shape(cause: Cause, model: Model) -> Cause:
    """With what was chosen and not fitted, known exactly: the order of a line, the exponent of a
    law; and without further lines of which there is nothing."""
    own, effect = cause.parameters, find_effect(cause.effect)
    first, *further = effect.strengths
    places = {strength.removesuffix(first) for strength in further if strength.endswith(first)}
    nothing = tuple(p for p in places if p and not _is_there(own.get(p + first)))
    chosen = [p.name for p in effect.parameters if p.prior.above > -np.inf and p.name not in own]
    settings = model.effects[cause.effect]._asdict() if cause.effect in model.effects else {}
    shape = {name: _exactly(float(settings[name]), name) for name in chosen if name in settings}
    told = {n: q for n, q in {**own, **shape}.items() if not n.startswith(nothing)}
    return cause.model_copy(update={"parameters": told})


def _is_there(size: Quantity | None) -> bool:
    return size is not None and abs(size.value) > BESIDE_NOTHING * size.standard_error


def _exactly(value: float, name: str) -> Quantity:
    return Quantity(value=value, unit=unit_of(name), ci95=(value, value), standard_error=0.0)


def _foretold(one: Named) -> float:
    """The share of the cost that the screening said the cause would take."""
    screened = one.contender.effect
    return max((s.gain for s in one.round.screened if s.hypothesis.effect == screened), default=0.0)


def confidence(evidence: float, over_rival: float | None, screened_gain: float) -> float:
    """Probability that the class is right, from how far it leads and how much there was to find."""
    lead = 12.0 if over_rival is None else min(max(over_rival, 0.0), 12.0)
    foretold = min(max(screened_gain, 0.0), 0.5)
    score = 0.3 + 0.12 * lead + 0.06 * min(evidence, 20.0) + 2.0 * foretold
    return float(1.0 / (1.0 + np.exp(-score)))
