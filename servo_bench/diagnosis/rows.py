"""A recording's rows as a simulation needs them: how long each lasted, and where they are whole.

A command is held until the next row's ask, so that a skipped slot is the row before it, longer.
What lies beside a hole is simulated and not compared.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import FitError
from servo_bench.excitation.experiment import Phase
from servo_bench.kernels.response import LARGEST_UNEVENNESS, slot_numbers
from servo_bench.recording.recording import MISSING, Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

HOLE_PERIODS = 10.0
"""Data from elsewhere are cut in two where nothing came for so long."""
HELD_OUT_SHARE = 0.25
"""Of the time of a recording without a validation phase: its end."""


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Arrays of shape (rows,). `even` is true where nothing is wrong from a row to the next.

    `seen` and `held_out` are the rows that a fit may see and those that it is judged on.
    """

    recording: Recording
    period_s: float
    t_s: Array
    durations_s: Array
    even: Mask
    broken: Mask
    seen: Mask
    held_out: Mask

    def channel(self, name: str) -> Array:
        """A channel as floats of its own, NaN where a value did not come."""
        return np.array(self.recording[name], np.float64)

    def has(self, name: str) -> bool:
        """Whether anything came on that channel."""
        return name in self.recording and bool(np.isfinite(self.channel(name)).any())


def rows_of(recording: Recording) -> Rows:
    """The rows of a recording; FitError where there are too few, or times that do not rise."""
    if len(recording) < 2:
        raise FitError(
            f"the recording has {len(recording)} rows: a fit needs hundreds. Record it to its end."
        )
    period_s = recording.period_s
    durations_s, even, broken = _between(recording)
    durations_s, even = np.append(durations_s, period_s), np.append(even, False)
    t_s = np.concatenate(([0.0], np.cumsum(durations_s[:-1])))
    seen, held_out = _phases(recording, t_s)
    broken = np.append(broken, True)
    return Rows(recording, period_s, t_s, durations_s, even, broken, seen, held_out)


def _between(recording: Recording) -> tuple[Array, Mask, Mask]:
    """From each row to the next: how long, whether undisturbed, whether nothing joins them."""
    period_s = recording.period_s
    if "asked_ns" not in recording and "t_s" in recording:
        lasted = np.diff(recording["t_s"]).astype(np.float64)
        broken = (lasted <= 0.0) | (lasted > HOLE_PERIODS * period_s)
        if "run" in recording:
            broken |= np.diff(recording["run"]) != 0
        return np.where(broken, period_s, lasted), ~broken, broken
    slots = np.diff(slot_numbers(recording))
    if (slots < 1).any():
        raise FitError(
            "the recording's slots do not rise: it was joined from two runs. Use one run."
        )
    lasted = slots * period_s
    if "asked_ns" in recording:
        asked = np.diff(recording["asked_ns"]) * 1e-9
        lasted = np.where(asked > 0.0, asked, lasted)
    lasted = _by_the_device(recording, lasted)
    even = (slots == 1) & (np.abs(lasted / period_s - 1.0) <= LARGEST_UNEVENNESS)
    return lasted, even, np.zeros(even.size, np.bool_)


def _by_the_device(recording: Recording, lasted_s: Array) -> Array:
    """The device's own times where they came, and agree with the host's."""
    if "device_time_us" not in recording:
        return lasted_s
    device = recording["device_time_us"]
    told = (device[1:] != MISSING) & (device[:-1] != MISSING)
    steps = np.where(told, np.diff(np.where(device == MISSING, 0, device)), 0) * 1e-6
    agree = told & (np.abs(steps - lasted_s) <= LARGEST_UNEVENNESS * recording.period_s)
    return np.where(agree, steps, lasted_s)


def _phases(recording: Recording, t_s: Array) -> tuple[Mask, Mask]:
    """Lead-in and identification are seen and the validation held out; else the last quarter."""
    if "phase" in recording:
        phase = recording["phase"]
        seen = np.isin(phase, (Phase.LEAD_IN, Phase.IDENTIFICATION))
        held_out = phase == Phase.VALIDATION
        if held_out.any() and seen.any():
            return seen, held_out
    late = t_s >= t_s[0] + (1.0 - HELD_OUT_SHARE) * (t_s[-1] - t_s[0])
    return ~late, late
