"""A wave of the load's angle that a torque on the motor's shaft makes as well.

With the load's encoder alone nothing tells whether the shaft was turned or its reading is wrong. A
torque T sin(n theta + phi) that passes slowly turns the shaft of a loop with an integrator by

    T/(K_T K_I) sin(n theta + phi),

as a track off its centre would have it (n = 1), a shaft that meets another at an angle (2), or an
encoder's own lines. Every rig has such a torque: a bearing, a detent.
"""

from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence, block_z
from servo_bench.diagnosis.reading.orders import HIGHEST_MOTOR, Wave
from servo_bench.diagnosis.reading.revolution import ECCENTRIC, MISALIGNED
from servo_bench.diagnosis.reading.subdivision import EFFECT as SUBDIVISION
from servo_bench.diagnosis.searching.gate import HELD_Z
from servo_bench.diagnosis.searching.hypotheses import cogging_of
from servo_bench.diagnosis.searching.screening import Beside
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.unknowns import merged, widened
from sim_rig.effects import cogging
from sim_rig.effects.cogging import PLACES
from sim_rig.model import Model

TORQUE = "cogging"


class AsATorque(NamedTuple):
    """The fit with a torque in a wave's place, and its size in N m."""

    found: Found
    size_nm: float


def as_a_torque(whole: Evidence, final: Found, effect: str) -> AsATorque | None:
    """The fit with a torque of the wave's order in its place; None where the motor tells of one,
    no shaft has such an order, or the wave is better beyond chance."""
    wave = _wave_of(final.model, effect)
    if not whole.is_of_the_load_alone or wave is None or wave.order > HIGHEST_MOTOR:
        return None
    place = _place(final.model, wave.order)
    if place is None or wave.torque_nm <= 0.0:  # a loop without an integrator is not held
        return None
    kept = [u for u in final.unknowns if u.effect != effect]
    less = seek(whole, final.model.without(effect), kept, final.sigma, iterations=1, first=2)
    start = less.model if _has(less.model, place) else _turned_in(whole, less, wave, place)
    strength, phase = f"{place}torque_nm", f"{place}phase_rad"
    own = widened(TORQUE, (strength, phase), start, wave.torque_nm)
    found = seek(whole, start, merged(less.unknowns, own), final.sigma, iterations=3, first=1)
    costs, with_it = (f.errors.costs(final.sigma) for f in (found, final))
    if block_z(with_it, costs) > HELD_Z:
        return None
    return AsATorque(found, abs(found.value(f"{TORQUE}.{strength}")))


def _wave_of(model: Model, effect: str) -> Wave | None:
    """The torque that turns the shaft as the effect has it."""
    stiff = model.nominal.torque_constant_nm_per_a * model.nominal.integral_gain_a_per_rad
    params = model.effects[effect]
    if effect == ECCENTRIC:
        return Wave(1.0, stiff * float(params.amplitude_rad), float(params.phase_rad))
    if effect == MISALIGNED:
        return Wave(2.0, stiff * 0.25 * float(params.angle_rad) ** 2, 2.0 * float(params.phase_rad))
    if effect == SUBDIVISION:
        order, amplitude = float(params.line_order), float(params.amplitude_rad)
        return Wave(order, stiff * amplitude, float(params.phase_rad))
    return None


def _place(model: Model, order: float) -> str | None:
    """A line of the model's cogging that is of this order, or free."""
    params = model.effects.get(TORQUE, cogging.Params())
    same = (p for p in PLACES if _has(model, p) and getattr(params, f"{p}order") == order)
    free = (p for p in PLACES if not _has(model, p))
    return next(same, next(free, None))


def _has(model: Model, place: str) -> bool:
    """Whether the model's cogging has a line there."""
    params = model.effects.get(TORQUE, cogging.Params())
    return bool(getattr(params, f"{place}torque_nm") != 0.0)


def _turned_in(whole: Evidence, less: Found, wave: Wave, place: str) -> Model:
    """The model with the torque, as large and turned as fits best where all else moves along."""
    models = [_with(less.model, wave._replace(phase_rad=p), place) for p in (0.0, 0.5 * np.pi)]
    _, (sine, cosine) = Beside(less, TORQUE).gain(whole.seen(models))
    size_nm = wave.torque_nm * float(np.hypot(sine, cosine))
    phase_rad = float(np.arctan2(cosine, sine))
    return _with(less.model, Wave(wave.order, size_nm, phase_rad), place)


def _with(model: Model, wave: Wave, place: str) -> Model:
    """The model with a torque beside those that it has."""
    known = model.effects[TORQUE]._asdict() if TORQUE in model.effects else {}
    own = {place + name: value for name, value in cogging_of([wave]).items()}
    return model.with_effect(TORQUE, **{**known, **own})
