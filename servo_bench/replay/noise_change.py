"""Has the sensors' noise changed between two runs? From their standstill phases.

    angles   x = increments over sqrt(2), which for white noise have its deviation
    torque   x = what it is less its mean

    level = sqrt(m),  m = mean x^2,   var m = sum over lags k to L of (1 - |k|/(L + 1)) gamma(k) / n

with gamma the autocovariance of x^2 (Newey and West, Econometrica 55, 1987), and never below what
white normal noise has, 2 m^2/n. Differences of ln level are judged by Student's t, with n/(2 L + 1)
degrees of freedom from each run. A level below the sensor's own rounding, q / sqrt(12), is that
rounding.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from servo_bench.excitation.experiment import Phase
from servo_bench.recording.recording import Recording
from servo_bench.replay.change import Change

LAGS = 4
FEWEST = 64
"""Samples of standstill from which noise is told."""
SENSORS = (
    ("load_angle_rad", "load encoder noise", "rad", "load encoder"),
    ("motor_position_rad", "motor encoder noise", "rad", "motor encoder"),
    ("motor_torque_nm", "torque noise", "N m", "drive"),
)


class _Level(NamedTuple):
    """A level, the standard error of its logarithm, and the samples that it is from."""

    value: float
    log_error: float
    samples: int


def noise_changes(a: Recording, b: Recording) -> Iterator[Change]:
    """One change for each sensor that both runs have a standstill of."""
    for channel, name, unit, where in SENSORS:
        before, after = _level(a, channel), _level(b, channel)
        if before is None or after is None:
            continue
        error = math.hypot(before.log_error, after.log_error)
        freedom = (before.samples + after.samples) / (2 * LAGS + 1)
        distance = abs(math.log(after.value / before.value)) / error
        yield Change(
            name=name.replace(" ", "_") + ("_rad" if unit == "rad" else "_nm"),
            symbol=name,
            unit=unit,
            where=where,
            a=before.value,
            b=after.value,
            standard_error=error * before.value,
            p_value=float(2.0 * student.sf(distance, freedom)),
        )


def _level(recording: Recording, channel: str) -> _Level | None:
    if channel not in recording or "phase" not in recording:
        return None
    still = recording[channel][recording["phase"] == Phase.STANDSTILL].astype(np.float64)
    shown = np.diff(still) / math.sqrt(2.0) if channel.endswith("_rad") else still - np.mean(still)
    if shown.size < FEWEST or not np.isfinite(shown).all():
        return None
    floor = _quantum(recording, channel) ** 2 / 12.0
    squares = shown**2
    mean = max(float(squares.mean()), floor)
    if mean == 0.0:
        return None
    variance = max(_variance_of_mean(squares), 2.0 * mean**2 / shown.size)
    return _Level(math.sqrt(mean), 0.5 * math.sqrt(variance) / mean, shown.size)


def _variance_of_mean(values: NDArray[np.float64]) -> float:
    """Of a mean of correlated values."""
    off = values - values.mean()
    covariances = [float(off[k:] @ off[: off.size - k]) / off.size for k in range(LAGS + 1)]
    weights = [1.0, *(2.0 * (1.0 - k / (LAGS + 1)) for k in range(1, LAGS + 1))]
    return float(np.dot(weights, covariances)) / values.size


def _quantum(recording: Recording, channel: str) -> float:
    """The smallest step that came on the channel at all; 0 where it never moved."""
    values = recording[channel]
    steps = np.diff(np.unique(values[np.isfinite(values)]))
    steps = steps[steps > 1e-12]
    return float(steps.min()) if steps.size else 0.0
