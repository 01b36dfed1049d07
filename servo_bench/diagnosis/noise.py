"""The least error that a sensor allows: what it shows at standstill, and its quantum.

    floor^2 = standstill^2 + q^2/12 (twice for an increment, which has two ends)

Without a standstill phase the third difference stands for it: it lets a smooth motion vanish and
sees white noise sqrt(20) times enlarged. Where motion is not smooth that is too much, which only
weighs the signal less.
"""

import math

import numpy as np

from servo_bench.diagnosis.rows import Array, Rows
from servo_bench.excitation.experiment import Phase

FEWEST_STANDING = 50
SMALLEST = 1e-12
"""Of anything: a simulation without noise has weights too."""


def floor_of(rows: Rows, name: str, *, increments: bool) -> float:
    """One standard deviation of a sample, or of an increment from row to row, in SI."""
    values = rows.channel(name)
    ends = 2.0 if increments else 1.0
    quantum = ends * quantum_of(values) ** 2 / 12.0
    standing = _standing(rows, values, increments=increments)
    if standing.size >= FEWEST_STANDING:
        return math.sqrt(float(np.var(standing)) + quantum) + SMALLEST
    third = np.diff(values[np.isfinite(values)], 3)
    robust = 1.4826 * float(np.median(np.abs(third))) if third.size else 0.0
    white = robust / math.sqrt(20.0)
    return math.sqrt(ends * white**2 + quantum) + SMALLEST


def quantum_of(values: Array) -> float:
    """The smallest step between two values that came; zero where they never differ."""
    steps = np.diff(np.unique(values[np.isfinite(values)]))
    steps = steps[steps > 1e-9 * np.ptp(values[np.isfinite(values)])] if steps.size else steps
    return float(steps.min()) if steps.size else 0.0


def _standing(rows: Rows, values: Array, *, increments: bool) -> Array:
    if "phase" not in rows.recording:
        return np.empty(0)
    still = np.flatnonzero(rows.recording["phase"] == Phase.STANDSTILL)
    if still.size < 2:
        return np.empty(0)
    shown = values[still[0] : still[-1] + 1]
    shown = np.diff(shown) if increments else shown
    return np.asarray(shown[np.isfinite(shown)])
