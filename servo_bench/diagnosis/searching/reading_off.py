"""What the load's encoder says wrong by itself, put into the final fit as it was read off the data.

Beside a load that coasts a wave of a count gains no fit enough, among thousands of samples that a
bounce spoils; it is read off the others (`reading.revolution`, `reading.subdivision`).
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.reading.reading import Reading
from servo_bench.diagnosis.reading.revolution import ECCENTRIC, EFFECTS, not_at_rest, turn_waves
from servo_bench.diagnosis.reading.subdivision import EFFECT, subdivision
from servo_bench.diagnosis.searching.as_a_torque import TORQUE, AsATorque, as_a_torque
from servo_bench.diagnosis.searching.coasting import OTHERWISE, is_coasting
from servo_bench.diagnosis.searching.hypotheses import VEHICLE
from servo_bench.diagnosis.searching.joint import Named, without_effect
from servo_bench.diagnosis.searching.late import Late
from servo_bench.diagnosis.searching.scales import Scales
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.sizes import material_sizes
from servo_bench.diagnosis.searching.unknowns import Unknown
from sim_rig.effects import find_effect
from sim_rig.model import Model

READ_OFF = (*EFFECTS, EFFECT)
GRAVITY = "gravity_imbalance"
IN_PHASE_RAD, GIVES_RAD_PER_NM = 0.35, 0.03
"""Of a face under the load's weight: one of 27 mN m made a wave of 0.011 rad/N m, in phase within
0.04 rad. One eccentric track in nine is so by chance, where it is that small."""


def with_readings(
    whole: Evidence, final: Found, named: Sequence[Named], late: Late, out: Collection[str]
) -> tuple[Found, list[Named], tuple[Reading, ...]]:
    """The final fit with what the load's encoder says wrong by itself, as it was read off the data,
    none of `out`; the causes that rounds have named, less those; and the readings.

    A wave once or twice a revolution that a round has found already stays as it was fitted; the
    disc's is surer and sharper as it is read.
    """
    readings, seen = list[Reading](), whole.fitted[0]
    final, named = _without_false_waves(whole, final, named, late.band)
    final, named = _as_torques(final, named, late)
    if not OTHERWISE & final.model.effects.keys() or is_coasting(final.model):
        waves = (wave.reading() for wave in turn_waves(seen, final.model))
        readings += [r for r in waves if _is_new(r, final, out) and _is_large(r, late.scales)]
    final = _put(whole, final, readings)
    scale = subdivision(seen, final.model.without(EFFECT)) if EFFECT not in out else None
    if scale is not None:
        wave = _put(whole, final, [scale.reading()])
        torque = as_a_torque(whole, wave, EFFECT)
        readings += [scale.reading()] if torque is None else []
        if torque is None or _is_small(torque, late.scales):
            final = wave if torque is None else torque.found
    read = {one.effect for one in readings}
    return final, [n for n in named if n.effect not in read], tuple(readings)


def is_windup(model: Model) -> bool:
    """Whether an eccentricity stands where the weight that was found presses the load into a face:
    k (-T sin(y + phi)), with no more than metal gives way by.

    A face's stiffness is fitted to impacts. Under a weight it is softer, as Hertz's law has it
    (p ~ T^(2/3)), so that a wave of 1e-4 rad and more is left, which is not the encoder's. Where
    that fit came out softer than the weight finds it, a wave against the weight takes off as much
    of what the fitted face gives way.
    """
    if not {ECCENTRIC, GRAVITY} <= model.effects.keys():
        return False
    weight, wave = model.effects[GRAVITY], model.effects[ECCENTRIC]
    along = np.exp(1j * (wave.phase_rad - weight.phase_rad - np.pi))
    if abs(np.angle(along)) < IN_PHASE_RAD:
        return bool(wave.amplitude_rad < GIVES_RAD_PER_NM * weight.torque_nm)
    face = float(getattr(model.effects.get(VEHICLE), "compliance_rad_per_nm", 0.0))
    against = abs(np.angle(-along)) < IN_PHASE_RAD
    return bool(against and wave.amplitude_rad < face * weight.torque_nm)


def _without_false_waves(
    whole: Evidence, final: Found, named: Sequence[Named], band: Sequence[Unknown]
) -> tuple[Found, list[Named]]:
    """The final fit and its causes, less the waves that the load has not where it rests, and less
    one that is what a face gives way to the load's weight."""
    false = set(not_at_rest(whole.fitted[0], final.model))
    false |= {ECCENTRIC} if is_windup(final.model) else set()
    false &= {n.effect for n in named}
    for effect in sorted(false):
        final = without_effect(whole, final, effect, band)
    return final, [n for n in named if n.effect not in false]


def _as_torques(final: Found, named: Sequence[Named], late: Late) -> tuple[Found, list[Named]]:
    """The final fit and its causes, less the waves that a torque makes as well which is too small
    for a name. A larger one is told beside the wave."""
    kept = list[Named]()
    for one in named:
        torque = as_a_torque(late.whole, final, one.effect) if one.effect in READ_OFF else None
        if torque is None:
            kept.append(one)
        elif _is_small(torque, late.scales):
            final = torque.found
        else:
            kept.append(replace(one, as_well=frozenset({TORQUE})))
    return final, kept


def _is_small(torque: AsATorque, scales: Scales) -> bool:
    return torque.size_nm < material_sizes(scales)[TORQUE]


def _is_new(reading: Reading, final: Found, out: Collection[str]) -> bool:
    return reading.effect not in out and reading.effect not in final.model.effects


def _is_large(reading: Reading, scales: Scales) -> bool:
    """Enough for a name."""
    strength = find_effect(reading.effect).strengths[0]
    return reading.settings[strength] >= material_sizes(scales)[reading.effect]


def _put(whole: Evidence, final: Found, readings: Sequence[Reading]) -> Found:
    if not readings:
        return final
    model, read = final.model, {one.effect for one in readings}
    for one in readings:
        model = model.with_effect(one.effect, **one.settings)
    unknowns = tuple(u for u in final.unknowns if u.effect not in read)
    return seek(whole, model, unknowns, final.sigma, iterations=1, first=2)
