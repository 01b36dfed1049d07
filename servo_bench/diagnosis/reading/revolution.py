"""What the load's encoder says wrong once or twice in a revolution, read off what it says.

A track off its centre and a shaft that meets another at an angle change the reading at once, and
nothing else. Where the load rests on a face, its angle beside the motor's is that and the gap:

    e = c + b s + d_1 s sin y + d_2 s cos y + sum_n (a_n sin n y + b_n cos n y) + v,   n = 1, 2

e    error of the load's angle beside the motor's, less the simulation's
s    the face it rests on, -1 or 1; where the simulation has it between them nothing is asked
c    where it was counted from
b    what the gap is wrong by; d_1, d_2: that, as it turns
v    noise, and a load that bounced (`resting`)
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.reading.reading import Reading
from servo_bench.diagnosis.reading.resting import (
    NOISIER,
    Regular,
    Resting,
    in_halves,
    regular,
    resting,
)
from sim_rig.model import Model

ECCENTRIC, MISALIGNED = EFFECTS = ("encoder_eccentricity", "misalignment")
CLEARLY, AGREES, ALIKE = 8.0, 4.0, 0.3
"""Standard errors of the wave beyond zero; by which both halves of the record may differ, or else
by such a share of the wave. Of ten rigs of development seeds that had none the waves were 0.4 to
3.5 beyond zero; of nine that had one of 0.4 to 2 counts, 13 to 82."""
OF_IT = 0.5
"""Of a model's wave that the load must have where it rests."""
LEAST = 0.3
"""Of the sensor's noise at rest: a smaller wave is as well what a simulation misses of the bounces
(one of 2e-5 rad stood 6.6 errors beyond zero in a gap that was wrong by 2 mrad)."""
FEWEST_TURNS = 0.9
"""A smaller part of a revolution is as well a drift."""


class TurnWave(NamedTuple):
    """The wave amplitude_rad sin(order y + phase_rad) in the load's angle, and how sure."""

    order: int
    amplitude_rad: float
    phase_rad: float
    standard_error_rad: float

    def reading(self) -> Reading:
        """As the catalogue's effect. A misalignment b makes b^2/4 sin(2 (y + phi))."""
        amplitude, error = self.amplitude_rad, self.standard_error_rad
        often = ("once", "twice")[self.order - 1]
        sentence = (
            f"The load's angle has a wave of {amplitude:.2g} ± {1.96 * error:.1g} rad {often} a "
            "revolution, alike in both halves of the recording."
        )
        if self.order == 1:
            settings = {"amplitude_rad": amplitude, "phase_rad": self.phase_rad}
            errors = {"amplitude_rad": error, "phase_rad": error / amplitude}
            return Reading(ECCENTRIC, settings, errors, sentence)
        root = float(np.sqrt(amplitude))
        settings = {"angle_rad": 2.0 * root, "phase_rad": 0.5 * self.phase_rad}
        errors = {"angle_rad": error / root, "phase_rad": 0.5 * error / amplitude}
        return Reading(MISALIGNED, settings, errors, sentence)


def turn_waves(comparison: Comparison, model: Model) -> tuple[TurnWave, ...]:
    """The waves that are there, in both halves of the recording; none without a motor's encoder."""
    asked = _asked(comparison, model)
    if asked is None:
        return ()
    rests, columns, whole = asked
    halves = in_halves(columns, rests.error, rests.rows_per_block)
    found = {order: _wave(order, whole, rests) for order in (1, 2)}
    return tuple(w for order, w in found.items() if w is not None and _is_alike(w, halves))


def not_at_rest(comparison: Comparison, model: Model) -> frozenset[str]:
    """Of the model's waves, those that the load has not where it rests: what is left there beside
    the model is the wave itself, turned round. A fit may have bent one to a load that bounces."""
    asked = _asked(comparison, model)
    if asked is None:
        return frozenset()
    rests, _, whole = asked
    left = {order: _wave(order, whole, rests) for order in (1, 2)}
    return frozenset(
        effect
        for effect, wave in zip(EFFECTS, left.values(), strict=True)
        if effect in model.effects and wave is not None and _undoes(wave, model)
    )


def _asked(comparison: Comparison, model: Model) -> tuple[Resting, Array, Regular] | None:
    """The rows at rest, their columns, and what is regular there; None where that tells nothing."""
    rests = resting(comparison, model)
    if rests is None or np.ptp(rests.angle) < FEWEST_TURNS * 2.0 * np.pi:
        return None
    columns = np.column_stack([*waves_of(rests.angle), *beside(rests)])
    whole = regular(columns, rests.error, rests.rows_per_block)
    return None if whole.scatter > NOISIER * rests.floor_rad else (rests, columns, whole)


def _undoes(left: TurnWave, model: Model) -> bool:
    params = model.effects[EFFECTS[left.order - 1]]
    if left.order == 1:
        amplitude, phase = float(params.amplitude_rad), float(params.phase_rad)
    else:
        amplitude, phase = 0.25 * float(params.angle_rad) ** 2, 2.0 * float(params.phase_rad)
    has = amplitude * np.exp(1j * phase)
    return bool(abs(has + left.amplitude_rad * np.exp(1j * left.phase_rad)) < OF_IT * abs(has))


def waves_of(angle: Array) -> tuple[Array, ...]:
    """Sine and cosine of orders one and two."""
    return np.sin(angle), np.cos(angle), np.sin(2.0 * angle), np.cos(2.0 * angle)


def beside(rests: Resting) -> tuple[Array, ...]:
    """The columns of c, b, d_1 and d_2."""
    face = rests.face
    sine, cosine = np.sin(rests.angle), np.cos(rests.angle)
    return np.ones_like(face), face, face * sine, face * cosine


def _wave(order: int, whole: Regular, rests: Resting) -> TurnWave | None:
    """One order's wave, where it is clear and large enough."""
    own = slice(2 * order - 2, 2 * order)
    found, spread = whole.found[own], whole.spread[own, own]
    amplitude = float(np.hypot(*found))
    clearly = found @ np.linalg.solve(spread, found) > CLEARLY**2
    if not clearly or amplitude < LEAST * rests.floor_rad:
        return None
    error = float(np.sqrt(0.5 * np.trace(spread)))
    return TurnWave(order, amplitude, float(np.arctan2(found[1], found[0])), error)


def _is_alike(wave: TurnWave, halves: Sequence[Regular]) -> bool:
    own = slice(2 * wave.order - 2, 2 * wave.order)
    apart = float(np.hypot(*(halves[0].found[own] - halves[1].found[own])))
    errors = [0.5 * np.trace(half.spread[own, own]) for half in halves]
    return apart < max(AGREES * float(np.sqrt(sum(errors))), ALIKE * wave.amplitude_rad)
