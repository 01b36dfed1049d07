"""What the load's encoder says wrong once or twice in a revolution, read off what it says.

A track off its centre and a shaft that meets another at an angle change the reading at once, and
nothing else. Where the load rests on a face, its angle beside the motor's is that and the gap:

    e = c + b s + d_1 s sin y + d_2 s cos y + sum_n (a_n sin n y + b_n cos n y) + v,   n = 1, 2

e    error of the load's angle beside the motor's, less the simulation's
s    the face it rests on, -1 or 1; where the simulation has it between them nothing is asked
c    where it was counted from
b    what the gap is wrong by; d_1, d_2: that, as it turns
v    noise; errors beyond a few of its deviations count for nothing (Tukey's biweight), for a load
     that bounced is somewhere else

By weighted least squares, with the block sandwich for its covariance. A load that is thrown through
its gap spoils the cost of a fit by more than so small a wave gains; it does not spoil this.
"""

from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.noise import floor_of
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.reading.reading import Reading
from sim_rig.model import Model

ECCENTRIC, MISALIGNED = EFFECTS = ("encoder_eccentricity", "misalignment")
ON_A_FACE, BEYOND, TURNS = 0.9, 4.0, 8
"""Of half the way from face to face; deviations that count; and how often they are weighed."""
BLOCK_S, FEWEST = 0.25, 400
CLEARLY, AGREES, ALIKE, NOISIER = 8.0, 4.0, 0.3, 3.0
"""Standard errors of the wave beyond zero; by which both halves of the record may differ, or else
by such a share of the wave; and by how much more than the sensor at rest the rest may scatter. Of
ten rigs of development seeds that had none the waves were 0.4 to 3.5 beyond zero; of nine that had
one of 0.4 to 2 counts, 13 to 82."""
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


class _Resting(NamedTuple):
    """Rows with the load on a face: its angle, its error beside the motor's, and the face."""

    angle: Array
    error: Array
    face: Array
    rows_per_block: int

    def part(self, where: slice) -> "_Resting":
        """Of a part of the recording."""
        rows = (self.angle[where], self.error[where], self.face[where])
        return _Resting(*rows, self.rows_per_block)


def turn_waves(comparison: Comparison, model: Model) -> tuple[TurnWave, ...]:
    """The waves that are there, in both halves of the recording; none without a motor's encoder."""
    resting = _resting(comparison, model)
    if resting is None or np.ptp(resting.angle) < FEWEST_TURNS * 2.0 * np.pi:
        return ()
    floor_rad = floor_of(comparison.source.rows, "load_angle_rad", increments=False)
    found, spread, left = _fitted(resting)
    if left > NOISIER * floor_rad:
        return ()
    half = resting.angle.size // 2
    halves = [_fitted(resting.part(where)) for where in (slice(half), slice(half, None))]
    waves = list[TurnWave]()
    for order in (1, 2):
        own = slice(2 * order - 2, 2 * order)
        amplitude = float(np.hypot(*found[own]))
        error = float(np.sqrt(0.5 * np.trace(spread[own, own])))
        apart = float(np.hypot(*(halves[0][0][own] - halves[1][0][own])))
        errors = [0.5 * np.trace(each[1][own, own]) for each in halves]
        may = max(AGREES * float(np.sqrt(sum(errors))), ALIKE * amplitude)
        large = amplitude > LEAST * floor_rad
        clearly = found[own] @ np.linalg.solve(spread[own, own], found[own]) > CLEARLY**2
        if large and clearly and apart < may:
            phase = float(np.arctan2(found[own][1], found[own][0]))
            waves.append(TurnWave(order, amplitude, phase, error))
    return tuple(waves)


def _resting(comparison: Comparison, model: Model) -> _Resting | None:
    rows, piece = comparison.source.rows, comparison.pieces[0].piece
    if not (rows.has("load_angle_rad") and rows.has("motor_position_rad")):
        return None
    shown = comparison.source.play(model, piece)
    angle, motor = (
        rows.channel(name)[piece.rows] for name in ("load_angle_rad", "motor_position_rad")
    )
    twist = np.asarray(shown["load_angle_rad"]) - np.asarray(shown["motor_position_rad"])
    error = angle - motor - twist
    way = 0.5 * float(np.ptp(twist))
    place = (twist - 0.5 * (twist.max() + twist.min())) / max(way, 1e-12)
    known = np.isfinite(error) & rows.seen[piece.rows] & (np.abs(place) > ON_A_FACE)
    if known.sum() < FEWEST:
        return None
    rows_per_block = max(1, round(BLOCK_S / rows.period_s))
    return _Resting(angle[known], error[known], np.sign(place[known]), rows_per_block)


def _fitted(resting: _Resting) -> tuple[Array, Array, float]:
    """Sine's and cosine's part of both orders, shape (4,), their covariance, and the scatter."""
    y, face = resting.angle, resting.face
    waves = [np.sin(y), np.cos(y), np.sin(2.0 * y), np.cos(2.0 * y)]
    beside = [np.ones_like(y), face, face * np.sin(y), face * np.cos(y)]
    columns = np.column_stack([*waves, *beside])
    weight, found, left = np.ones_like(y), np.zeros(columns.shape[1]), resting.error
    scatter = 0.0
    for _ in range(TURNS):
        root = np.sqrt(weight)
        found = np.linalg.lstsq(columns * root[:, None], resting.error * root, rcond=None)[0]
        left = resting.error - columns @ found
        scatter = max(1.4826 * float(np.median(np.abs(left))), 1e-12)
        weight = np.maximum(1.0 - (left / (BEYOND * scatter)) ** 2, 0.0) ** 2
    inverse = np.linalg.pinv(columns.T @ (columns * weight[:, None]))
    rows = y.size // resting.rows_per_block * resting.rows_per_block
    pulls = (columns * (weight * left)[:, None])[:rows]
    blocks = pulls.reshape(-1, resting.rows_per_block, columns.shape[1]).sum(axis=1)
    spread = inverse @ (blocks.T @ blocks) @ inverse
    return found[:4], spread[:4, :4], scatter
