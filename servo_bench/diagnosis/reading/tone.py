"""A tone in time that stands in the load's error: something outside of the rig shakes it."""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.noise import COMMAND
from servo_bench.diagnosis.comparing.rows import Array, Mask
from sim_rig.model import Model

SMOOTH_ROWS = 25
TONE = 60.0
"""Power of a line in time over its surroundings: exp(-60) by chance, and models are not perfect."""
LEAST_ABOUT = 0.4
"""Of the whole spectrum's middle, that a line's surroundings count for: where the motion leaves a
hole in the error's spectrum, anything stands out of it."""
AUDIBLE = 0.3
"""Amplitude of such a line, in sensor floors, below which it is nothing to speak of."""
AGAIN, FALLEN, MOST = 0.8, 0.5, 2 / 3
"""Correlation of one period of the commands with the next, which lost ones lower; what it falls
below within one; and the longest period, of all that was played."""


class Tone(NamedTuple):
    """A line in time: its frequency, amplitude in the load's angle, and how far it stands out."""

    frequency_hz: float
    amplitude_rad: float
    height: float


def tone(comparison: Comparison, model: Model) -> Tone | None:
    """The strongest line in time of the load's (or twist's) error, where one stands out.

    An excitation without periods within the record makes no such line, nor does any effect: it
    comes from elsewhere. Where commands come again and again, what the error repeats with them is
    theirs, and lines at multiples of their rate are not asked.
    """
    levels = [k for k, s in enumerate(comparison.signals) if s.level]
    if not levels or len(comparison.pieces) > 1:
        return None
    error = comparison.errors(model)[levels[0]]
    known = np.isfinite(error) & comparison.seen
    if known.sum() < 512:
        return None
    sigma = max(1.4826 * float(np.median(np.abs(error[known]))), 1e-12)
    quick = np.where(known, error, 0.0)
    quick = np.clip(quick - median_filter(quick, SMOOTH_ROWS), -3.0 * sigma, 3.0 * sigma)
    quick = _without_repeats(quick, known, comparison)
    window = np.hanning(quick.size)
    power = np.abs(np.fft.rfft(quick * window)) ** 2
    about = median_filter(power, 101, mode="nearest") / np.log(2.0)
    everywhere = float(np.median(power)) / np.log(2.0)
    height = power / np.maximum(about, max(LEAST_ABOUT * everywhere, 1e-300))
    best = int(np.argmax(height[8:])) + 8
    if height[best] < TONE:
        return None
    amplitude = 2.0 * float(np.sqrt(power[best])) / float(window.sum())
    if amplitude < AUDIBLE * comparison.signals[levels[0]].floor:
        return None
    frequency = best / (quick.size * comparison.source.rows.period_s)
    return Tone(frequency, amplitude, float(height[best]))


def _without_repeats(quick: Array, known: Mask, comparison: Comparison) -> Array:
    """Less the mean of what comes at the same place of every period of the commands."""
    rows = comparison.source.rows
    slots = np.rint(rows.t_s / rows.period_s).astype(np.int64)
    sent = np.full(int(slots[-1]) + 1, np.nan)
    sent[slots[rows.seen]] = rows.channel(COMMAND)[rows.seen]
    period = period_of(sent)
    if period == 0:
        return quick
    place = slots[comparison.pieces[0].end] % period
    came = np.maximum(np.bincount(place, known, period), 1.0)
    mean = np.bincount(place, np.where(known, quick, 0.0), period) / came
    return np.asarray(np.where(known, quick - mean[place], 0.0))


def period_of(commands: Array) -> int:
    """After how many slots commands come again, for half a period and more; 0 where they do not.

    By the correlation with themselves of what differs from their mean, from the first to the last
    that came and is not 0; NaN where none did. It has to fall before it comes back, or whatever is
    held would repeat.
    """
    moving = np.flatnonzero(np.nan_to_num(commands))
    if moving.size == 0:
        return 0
    played = commands[moving[0] : moving[-1] + 1]
    played = np.nan_to_num(played - np.nanmean(played))
    size = played.size
    power = np.abs(np.fft.rfft(played, 2 * size)) ** 2
    lags = np.arange(1, int(MOST * size) + 1)
    energy = np.concatenate(([0.0], np.cumsum(played**2)))
    both = np.sqrt(energy[size - lags] * (energy[size] - energy[lags]))
    alike = np.fft.irfft(power)[lags] / np.maximum(both, 1e-300)
    again = (alike > AGAIN) & np.logical_or.accumulate(alike < FALLEN)
    return int(lags[np.argmax(again)]) if again.any() else 0
