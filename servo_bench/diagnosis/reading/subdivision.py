"""Sub-divisional error of the load's encoder, read off what it says.

An encoder's interpolation is uneven within each line of its disc: y = x + a sin(n x + phi), at the
same place of every line. n is a whole number, and as high as nothing else that repeats with a
shaft. So the error of the load's angle beside the motor's, from which what is slow is taken, is
asked for every order at once: one Fourier transform over the angle.

    h(n) = 2 |sum v exp(-j n y)|^2 / sum v^2        exp(-h/2) by chance, for each of 4184 orders

Where errors hang together (a shaft that rests between commands says the same thing many times) all
lines are higher than that. They are told in units of what a hundredth of them exceeds, over what it
would be by chance: one line that stands out raises it by nothing.

Too faint a one moves no cost of a fit, which weighs what any rig may miss; yet it is in the data.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.noise import floor_of
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.reading.orders import OrderLine
from servo_bench.diagnosis.reading.reading import Reading
from servo_bench.diagnosis.reading.resting import FEWEST as REST
from servo_bench.diagnosis.reading.resting import resting
from sim_rig.model import Model

EFFECT = "encoder_subdivision"
LOWEST_ORDER, HIGHEST_ORDER = 16, 4200
ROWS, FEWEST = 7, 100
"""What is slow is the middle of so many rows; and the fewest samples of which lines are asked."""
STANDS_OUT, NAMED, SLOW_ROWS = 30.0, 1.25, (ROWS, 25)
"""Of a line that is tried, and so many times that of one that is named by itself; asked beside the
middle of few rows, and of many, where bounces in the gap hide less. Chance made lines up to 27 in
58 recordings of development seeds that had no wave (at 1 kHz, of 82 before units); a wave of a
third of a count made 74. Where a load bounces, what scatters by more than the sensor's noise counts
for less: one of a count made 21 of all that scattered there and 51 so, chance up to 25."""
RARE = 0.01
"""Share of the lines that is higher than -2 ln of it by chance."""
BEYOND = 4.0
"""Errors beyond so many deviations count for nothing: bounces would make lines of their own."""
PLACES = 1 << 17
"""A revolution's, by which an angle is told for a line: a fifteenth of a radian of the highest."""
TURNS = 4
CLEARLY, AGREES, NOISIER = 6.0, 3.0, 3.0
"""Standard errors: of the whole wave beyond zero; and of what both halves of the record, and what
was held out, may differ by. Where commands come again and again, so do places and errors, and
halves agree by chance: two waves of half a count that were not there stood at 8 and 9, and were 5.7
and 7.6 from what was held out. What is quick and so much noisier than the sensor at rest is the
simulation's, not the disc's: it was 1.0 to 2.6 of that on 23 rigs of development seeds, and 7 and
30 on two that coast."""


class Subdivision(NamedTuple):
    """The wave amplitude_rad sin(line_order y + phase_rad) in the load's angle, and how sure."""

    line_order: float
    amplitude_rad: float
    phase_rad: float
    standard_error_rad: float

    def reading(self) -> Reading:
        """As the catalogue's effect."""
        amplitude, error = self.amplitude_rad, self.standard_error_rad
        return Reading(
            EFFECT,
            {
                "line_order": self.line_order,
                "amplitude_rad": amplitude,
                "phase_rad": self.phase_rad,
            },
            {"amplitude_rad": error, "phase_rad": error / amplitude},
            f"The load's angle has a wave of {amplitude:.2g} ± {1.96 * error:.1g} rad in each of "
            f"{self.line_order:.0f} lines of its encoder's disc, alike in both halves of the "
            "recording.",
        )


class _Scale(NamedTuple):
    """The load's angle, what is wrong with it beside the motor's, and the sensor's noise."""

    angle: Array
    error: Array
    floor_rad: float

    def part(self, where: slice) -> "_Scale":
        """Of a part of the recording."""
        return _Scale(self.angle[where], self.error[where], self.floor_rad)


def load_lines(comparison: Comparison, model: Model, most: int = 3) -> tuple[OrderLine, ...]:
    """The strongest lines of high order in the load's own angle, whole orders only."""
    scale = _scale(comparison, model)
    return () if scale is None else _lines(scale, most)


def subdivision(comparison: Comparison, model: Model) -> Subdivision | None:
    """The strongest line's wave, where both halves of the recording have the same one, and what was
    held out does not speak against it; of all rows, or where that has none of those in which the
    load rests."""
    for of in (_scale, _at_rest):
        wave = _told(of(comparison, model))
        if wave is not None and not _is_denied(wave, of(comparison, model, held_out=True)):
            return wave
    return None


def _told(scale: _Scale | None) -> Subdivision | None:
    lines = _lines(scale, 1, NAMED) if scale is not None else ()
    if scale is None or not lines:
        return None
    order, half = lines[0].order, scale.angle.size // 2
    wave, deviation = _wave(scale, order)
    first, second = (_wave(scale.part(where), order) for where in (slice(half), slice(half, None)))
    amplitude = float(np.hypot(*wave))
    left = _deviation(scale.error - _shape(scale, order) @ wave)
    faint = amplitude < CLEARLY * deviation
    if not _are_alike(first, second) or faint or left > NOISIER * scale.floor_rad:
        return None
    return Subdivision(order, amplitude, float(np.arctan2(wave[1], wave[0])), deviation)


def _is_denied(wave: Subdivision, held: _Scale | None) -> bool:
    """Whether what was held out has another wave there, or none; few rows of it deny little."""
    if held is None:
        return False
    phase = np.array([np.cos(wave.phase_rad), np.sin(wave.phase_rad)])
    here = wave.amplitude_rad * phase, wave.standard_error_rad
    return not _are_alike(here, _wave(held, wave.line_order))


def _are_alike(one: tuple[Array, float], other: tuple[Array, float]) -> bool:
    """Whether two waves, each with its standard error, differ by no more than that."""
    apart = float(np.hypot(*(one[0] - other[0])))
    return apart <= AGREES * float(np.hypot(one[1], other[1]))


def _at_rest(comparison: Comparison, model: Model, *, held_out: bool = False) -> _Scale | None:
    rests = resting(comparison, model, held_out=held_out, fewest=FEWEST if held_out else REST)
    return None if rests is None else _Scale(rests.angle, rests.error, rests.floor_rad)


def _scale(comparison: Comparison, model: Model, *, held_out: bool = False) -> _Scale | None:
    rows, piece = comparison.source.rows, comparison.longest
    if not rows.has("load_angle_rad"):
        return None
    shown = comparison.source.play(model, piece)
    angle = rows.channel("load_angle_rad")[piece.rows]
    error = angle - np.asarray(shown["load_angle_rad"])
    if rows.has("motor_position_rad"):
        motor = rows.channel("motor_position_rad")[piece.rows]
        error = error - (motor - np.asarray(shown["motor_position_rad"]))
    asked = rows.held_out if held_out else rows.seen
    known = np.isfinite(error) & asked[piece.rows]
    if known.sum() < FEWEST:
        return None
    floor_rad = floor_of(rows, "load_angle_rad", increments=False)
    return _Scale(angle[known], error[known], floor_rad)


def _quick(error: Array, rows: int = ROWS, most_rad: float = np.inf) -> Array:
    """What of the error is quick, in its own deviations, or in `most_rad` where that is less."""
    quick = error - median_filter(error, rows)
    return np.asarray(quick / max(min(_spread(quick), most_rad), 1e-12))


def _deviation(error: Array) -> float:
    """Of what is quick."""
    return _spread(error - median_filter(error, ROWS))


def _spread(values: Array) -> float:
    return 1.4826 * float(np.median(np.abs(values)))


def _lines(scale: _Scale, most: int, least: float = 1.0) -> tuple[OrderLine, ...]:
    deviations = (np.inf, scale.floor_rad)
    heights = [_heights(scale, rows, most) for rows in SLOW_ROWS for most in deviations]
    highest = np.max(heights, axis=0)
    turns = max(float(np.ptp(scale.angle)) / (2.0 * np.pi), 0.25)
    found: list[OrderLine] = []
    for place in np.argsort(-highest)[:40]:
        order, height = float(place), float(highest[place])
        apart = all(abs(order - f.order) > max(3.0, 2.0 / turns) for f in found)
        if height > least * STANDS_OUT and apart:
            found.append(OrderLine(order, height / scale.angle.size, height))
    return tuple(found[:most])


def _heights(scale: _Scale, rows: int, most_rad: float) -> Array:
    """Of every order from zero to the highest, in units of chance; zero below the lowest. What
    counts is judged by the errors' own deviation, or by `most_rad` where that is less."""
    quick = _quick(scale.error, rows, most_rad)
    values = quick * np.maximum(1.0 - (quick / BEYOND) ** 2, 0.0) ** 2  # Tukey's biweight
    places = np.rint(scale.angle * (PLACES / (2.0 * np.pi))).astype(np.int64) % PLACES
    waves = np.fft.rfft(np.bincount(places, values, PLACES))[:HIGHEST_ORDER]
    heights = np.asarray(2.0 * np.abs(waves) ** 2 / max(float(values @ values), 1e-300))
    together = float(np.quantile(heights[LOWEST_ORDER:], 1.0 - RARE)) / (-2.0 * np.log(RARE))
    heights[:LOWEST_ORDER] = 0.0
    return np.asarray(heights / max(together, 1.0))


def _wave(scale: _Scale, order: float) -> tuple[Array, float]:
    """Sine's and cosine's part of the error, rad, and the standard error of each.

    From all three what is slow is taken alike, so that a wave which is slow itself, where the shaft
    hardly turns, counts for as little as it shows. What counts is judged beside the wave that was
    found: beside none, a part of the wave itself would count for less.
    """
    shape = _shape(scale, order)
    wave, spread = np.zeros(2), np.eye(2)
    for _ in range(TURNS):
        weight = (np.abs(_quick(scale.error - shape @ wave)) < BEYOND).astype(np.float64)
        columns = np.column_stack([_without_slow(part, weight) for part in shape.T])
        error = _without_slow(scale.error, weight)
        inverse = np.linalg.pinv(columns.T @ (columns * weight[:, None]))
        wave = inverse @ (columns.T @ (error * weight))
        left = weight * (error - columns @ wave)
        spread = inverse @ (columns.T @ (columns * (left**2)[:, None])) @ inverse
    return wave, float(np.sqrt(0.5 * np.trace(spread)))


def _shape(scale: _Scale, order: float) -> Array:
    return np.column_stack([np.sin(order * scale.angle), np.cos(order * scale.angle)])


def _without_slow(values: Array, weight: Array) -> Array:
    """Beside the weighted mean of so many rows."""
    around = uniform_filter1d(weight * values, ROWS) / np.maximum(
        uniform_filter1d(weight, ROWS), 1e-9
    )
    return np.asarray(values - around)
