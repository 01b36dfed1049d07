"""When command, motor and load samples of a slot really were, against the slot's ask.

command         deadline -> ask             the command acts from the ask on (CANopen: the SYNC)
motor sample    ask -> instant of the motor's angle, by SYNC (0) or by the bytes on the line
load sample     ask -> instant of the load's angle, likewise
motor answer    ask -> the drive's answer is read
load answer     ask -> the encoder's answer is read
device clock    how far the device's own time of the samples lies off the asks, offset and
                drift of the two clocks taken out: what is left is the jitter of the sampling
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servo_bench.recording.recording import DEVICE_WRAP_US, MISSING

Array = NDArray[np.float64]
FEWEST = 8
"""So many device times at the least, for an offset and a drift."""
INLIERS = 0.95
_CHANNELS = (
    ("command", "lateness_s"),
    ("motor sample", "motor_sampled_s"),
    ("load sample", "load_sampled_s"),
    ("motor answer", "drive_latency_s"),
    ("load answer", "encoder_latency_s"),
)


@dataclass(frozen=True, slots=True)
class Delay:
    """One line of the table: how many slots have it, how many lack it, median and 99th percentile.

    Of the device clock they are of the absolute value.
    """

    name: str
    slots: int
    missing: int
    median_s: float
    p99_s: float

    def facts(self) -> str:
        """As text for a file's metadata."""
        return (
            f"median_s={self.median_s:.9f} p99_s={self.p99_s:.9f} "
            f"slots={self.slots} missing={self.missing}"
        )

    def words(self) -> str:
        """For people."""
        missing = f", {self.missing} missing" if self.missing else ""
        return f"{self.name} {self.median_s * 1e6:.0f} us (p99 {self.p99_s * 1e6:.0f} us{missing})"


def alignment(columns: Mapping[str, NDArray[Any]] | NDArray[np.void]) -> tuple[Delay, ...]:
    """The delays that the channels tell, each of shape (rows,); what nothing tells is absent."""
    names = columns.dtype.names or () if isinstance(columns, np.ndarray) else tuple(columns)
    found = [
        (name, np.asarray(columns[channel], np.float64))
        for name, channel in _CHANNELS
        if channel in names
    ]
    if {"asked_ns", "device_time_us"} <= set(names):
        jitter_s = _device_jitter_s(columns["asked_ns"], columns["device_time_us"])
        found.append(("device clock", np.abs(jitter_s)))
    return tuple(_delay(name, values) for name, values in found if np.isfinite(values).any())


def _delay(name: str, values_s: Array) -> Delay:
    known = values_s[np.isfinite(values_s)]
    median_s, p99_s = np.percentile(known, [50, 99])
    return Delay(name, known.size, values_s.size - known.size, float(median_s), float(p99_s))


def _device_jitter_s(asked_ns: NDArray[np.int64], device_us: NDArray[np.int64]) -> Array:
    """Device time less ask, less its median line; NaN where one of the two is missing."""
    jitter_s = np.full(asked_ns.size, np.nan)
    told = (asked_ns != MISSING) & (device_us != MISSING)
    if told.sum() < FEWEST:
        return jitter_s
    asked, device = asked_ns[told], device_us[told]
    elapsed_s = (asked - asked[0]) * 1e-9
    steps_us = np.diff(device, prepend=device[0]) % DEVICE_WRAP_US
    off_s = np.cumsum(steps_us) * 1e-6 - elapsed_s
    off_s = off_s - _median_slope(elapsed_s, off_s) * elapsed_s
    off_s = off_s - np.median(off_s)
    near = np.abs(off_s) <= np.quantile(np.abs(off_s), INLIERS)  # without this host's stalls
    if np.ptp(elapsed_s[near]) > 0.0:
        off_s = off_s - np.polyval(np.polyfit(elapsed_s[near], off_s[near], 1), elapsed_s)
    jitter_s[told] = off_s - np.median(off_s)
    return jitter_s


def _median_slope(elapsed_s: Array, off_s: Array) -> float:
    """Between the medians of both halves: no stall bends it."""
    half = off_s.size // 2
    apart_s = float(np.median(elapsed_s[half:]) - np.median(elapsed_s[:half]))
    risen_s = float(np.median(off_s[half:]) - np.median(off_s[:half]))
    return risen_s / apart_s if apart_s > 0.0 else 0.0
