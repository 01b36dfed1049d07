"""The least error that a sensor allows: what it shows at standstill, and its quantum.

    floor^2 = standstill^2 + q^2/12 (twice for an increment, which has two ends)

A run has a standstill, the phase of that name; without one the third difference stands for it,
which lets a smooth motion vanish and sees white noise sqrt(20) times enlarged. Words that a line
spoils while the rig rests are wrong, and no noise.

Data from elsewhere have no phases. What their sensors show while the command rests (the rig may
still move), the third difference (a motion that is quick beside the rows is not smooth), and that
of what a simulation leaves (it may be wrong) are each the noise and more: the least of them counts.
Where a sensor does not change at all while the command rests, that tells nothing: a drive that is
off reports no torque.
"""

import math

import numpy as np
from numpy.typing import NDArray

from servo_bench.diagnosis.comparing.rows import Array, Rows
from servo_bench.excitation.experiment import Phase

FEWEST_STANDING = 50
SETTLED_S = 0.3
"""After a command to stop, and after a recording's beginning, which may follow one."""
COMMAND = "velocity_command_rad_s"
SPOILT = 6.0
"""Deviations and counts at rest beyond which a word is wrong."""
SMALLEST = 1e-12
"""Of anything: a simulation without noise has weights too."""


def floor_of(rows: Rows, name: str, *, increments: bool, simulated: Array | None = None) -> float:
    """One standard deviation of a sample, or of an increment from row to row, in SI.

    `simulated` is what a model shows of the channel, shape (rows,), NaN where it does not; it
    counts in recordings without phases.
    """
    values = rows.channel(name)
    ends = 2.0 if increments else 1.0
    quantum = ends * quantum_of(values) ** 2 / 12.0  # its variance
    phased = "phase" in rows.recording
    still = _of_the_phase(rows) if phased else _resting(rows)
    standing = _standing(still, values, increments=increments)
    rested = _variance(standing, quantum) if standing.size >= FEWEST_STANDING else math.inf
    if phased and math.isfinite(rested):
        return math.sqrt(rested + quantum) + SMALLEST
    known = [ends * _white(values) ** 2]
    if not phased:
        known += [ends * _white(values - simulated) ** 2] if simulated is not None else []
        known += [rested] if rested > 0.0 else []
    least = min(known)
    return math.sqrt((least if math.isfinite(least) else 0.0) + quantum) + SMALLEST


def rests(rows: Rows) -> bool:
    """Whether anything rests for long enough to tell noise from motion."""
    still = _of_the_phase(rows) if "phase" in rows.recording else _resting(rows)
    return still.size >= FEWEST_STANDING


def _variance(standing: Array, quantum: float) -> float:
    """Of what a sensor shows at rest, without samples further off than noise and a few counts."""
    middle = float(np.median(standing))
    deviation = 1.4826 * float(np.median(np.abs(standing - middle)))
    most = SPOILT * math.hypot(deviation, math.sqrt(12.0 * quantum))
    return float(np.var(standing[np.abs(standing - middle) <= most]))


def _white(values: Array) -> float:
    """White noise of a channel whose motion is smooth; infinite where nothing came."""
    third = np.diff(values[np.isfinite(values)], 3)
    if not third.size:
        return math.inf
    return 1.4826 * float(np.median(np.abs(third))) / math.sqrt(20.0)


def quantum_of(values: Array) -> float:
    """The smallest step between two values that came; zero where they never differ."""
    steps = np.diff(np.unique(values[np.isfinite(values)]))
    steps = steps[steps > 1e-9 * np.ptp(values[np.isfinite(values)])] if steps.size else steps
    return float(steps.min()) if steps.size else 0.0


def _standing(still: NDArray[np.intp], values: Array, *, increments: bool) -> Array:
    if still.size < 2:
        return np.empty(0)
    shown = values[still[0] : still[-1] + 1]
    shown = np.diff(shown) if increments else shown
    return np.asarray(shown[np.isfinite(shown)])


def _of_the_phase(rows: Rows) -> NDArray[np.intp]:
    return np.flatnonzero(rows.recording["phase"] == Phase.STANDSTILL)


def _resting(rows: Rows) -> NDArray[np.intp]:
    """Rows of the command's longest rest without a break, less those in which the rig comes to it.

    A row is broken where nothing joins it to the next.
    """
    if not rows.has(COMMAND):
        return np.empty(0, np.intp)
    rests = rows.channel(COMMAND) == 0.0
    joined = np.concatenate(([False], rests[1:] & rests[:-1] & ~rows.broken[:-1], [False]))
    edges = np.flatnonzero(joined[1:] != joined[:-1]).reshape(-1, 2)
    if not edges.size:
        return np.empty(0, np.intp)
    first, last = edges[np.argmax(edges[:, 1] - edges[:, 0])].tolist()
    return np.arange(first + round(SETTLED_S / rows.period_s), last + 1, dtype=np.intp)
