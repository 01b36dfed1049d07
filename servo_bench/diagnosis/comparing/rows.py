"""A recording's rows as a simulation needs them: how long each lasted, and where they are whole.

A command is held until the next row's ask, so that a skipped slot is the row before it, longer.
What lies beside a hole is simulated and not compared.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import ConfigError, FitError
from servo_bench.excitation.experiment import Phase
from servo_bench.kernels.response import LARGEST_UNEVENNESS, slot_numbers
from servo_bench.recording.recording import DEVICE_WRAP_US, MISSING, Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

HOLE_PERIODS = 10.0
"""Data from elsewhere are cut in two where nothing came for so long."""
HELD_OUT_SHARE = 0.25
"""Of the time of a recording without a validation phase: its end."""
STALL_ROWS, MOST_AWAY, FEW_AWAY, COARSE = 64, 0.5, 0.05, 0.1
"""After a stall the device's times are back beside the asks within so many rows; a clock that was
set stays off. No more of all rows may be away, and few where its ticks are a larger part of a
period than that."""
MOST_PERIODS, AT_ONCE_S = 8.0, 2e-6
"""That a sample may be taken before or after its ask; and what is at once."""
SAMPLED = {
    "motor_position_rad": "motor_sampled_s",
    "current_a": "current_sampled_s",
    "load_angle_rad": "load_sampled_s",
}
"""Which channel tells how long after the ask what a model shows was sampled. A drive answers for
all of its own at once; of a current, only data from elsewhere may tell something else."""
EFFORTS = ("current_a", "motor_torque_nm", "motor_current_a", "torque_nm")
FILTERED = "current_filtered_s"
"""Channel: the time constant of the low pass through which a current or torque was told."""


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Arrays of shape (rows,). `even` is true where nothing is wrong from a row to the next, and
    `timed` where how long it lasted is known, even or not.

    `seen` and `held_out` are the rows that a fit may see and those that it is judged on. `after_s`
    has, by what a model shows, how long after the command's acting it was sampled (below zero:
    before), where that was not at once; `filtered_s` is the current's low pass, zero without one.
    """

    recording: Recording
    period_s: float
    t_s: Array
    durations_s: Array
    even: Mask
    timed: Mask
    broken: Mask
    seen: Mask
    held_out: Mask
    after_s: Mapping[str, Array]
    filtered_s: float = 0.0

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
    durations_s, even, timed, broken = _between(recording)
    durations_s, even = np.append(durations_s, period_s), np.append(even, False)
    t_s = np.concatenate(([0.0], np.cumsum(durations_s[:-1])))
    seen, held_out = _phases(recording, t_s)
    timed, broken = np.append(timed, False), np.append(broken, True)
    return Rows(
        *(recording, period_s, t_s, durations_s, even, timed, broken, seen, held_out),
        after_s=_after(recording),
        filtered_s=_filtered_s(recording),
    )


def with_rows(
    recording: Recording, like: Sequence[int], at: Sequence[int], own: Mapping[str, Array]
) -> Recording:
    """With rows put in before rows `at`: channels in `own` have those values, other floats did not
    come, and whole numbers are those of the rows `like`."""
    channels = {}
    for name, values in recording.channels.items():
        did_not_come = np.full(len(like), np.nan)
        new = did_not_come if values.dtype.kind == "f" else values[np.asarray(like, np.intp)]
        channels[name] = np.insert(values, np.asarray(at, np.intp), own.get(name, new))
    return replace(recording, channels=channels)


def _after(recording: Recording) -> dict[str, Array]:
    """How long after the command's acting each was sampled, where one of them was not at once.

    Where a row does not tell, its time is the others' median; where none does, nothing is told.
    """
    told = {
        name: np.array(recording[after], np.float64)
        for name, after in SAMPLED.items()
        if after in recording
    }
    told = {name: after_s for name, after_s in told.items() if np.isfinite(after_s).any()}
    acts_s, most_s = _acts_s(recording, told) if told else 0.0, MOST_PERIODS * recording.period_s
    found = {}
    for name, after_s in told.items():
        off_s = np.where(np.isfinite(after_s), after_s, np.nanmedian(after_s)) - acts_s
        found[name] = np.clip(np.where(np.abs(off_s) > AT_ONCE_S, off_s, 0.0), -most_s, most_s)
    return found if any(off_s.any() for off_s in found.values()) else {}


def _filtered_s(recording: Recording) -> float:
    """By its channel, else by the recording's own rig file; of a current that came."""
    if not any(name in recording for name in EFFORTS):
        return 0.0
    told_s = recording[FILTERED] if FILTERED in recording else np.full(1, np.nan)
    if np.isfinite(told_s).any():
        return max(float(np.nanmedian(told_s)), 0.0)
    return recording.rig.drive.torque_filter_s if recording.rig is not None else 0.0


def filtered(recording: Recording, by_s: float) -> Recording:
    """The recording of a drive that tells its torque through a low pass, where it does not say."""
    if FILTERED in recording or not by_s:
        return recording
    told = {FILTERED: np.full(len(recording), by_s)}
    return replace(recording, channels={**recording.channels, **told})


def _acts_s(recording: Recording, told: Mapping[str, Array]) -> float:
    """From the ask until the drive has the command. A drive whose profile is not at hand has it
    with the request that reads its angle, as most have."""
    if recording.rig is None:
        return 0.0
    try:
        return recording.rig.command_after_s(recording.period_s)
    except ConfigError:
        motor_s = told.get("motor_position_rad")
        return float(np.nanmedian(motor_s)) if motor_s is not None else 0.0


def _between(recording: Recording) -> tuple[Array, Mask, Mask, Mask]:
    """From each row to the next: how long, whether undisturbed, whether the time is sure, and
    whether nothing joins them."""
    period_s = recording.period_s
    if "asked_ns" not in recording and "t_s" in recording:
        lasted = np.diff(recording["t_s"]).astype(np.float64)
        broken = (lasted <= 0.0) | (lasted > HOLE_PERIODS * period_s)
        if "run" in recording:
            broken |= np.diff(recording["run"]) != 0
        return np.where(broken, period_s, lasted), ~broken, ~broken, broken
    slots = np.diff(slot_numbers(recording))
    if (slots < 1).any():
        raise FitError(
            "the recording's slots do not rise: it was joined from two runs. Use one run."
        )
    lasted = slots * period_s
    if "asked_ns" in recording:
        asked = np.diff(recording["asked_ns"]) * 1e-9
        lasted = np.where(asked > 0.0, asked, lasted)
    lasted, told = _by_the_device(recording, lasted)
    even = (slots == 1) & (np.abs(lasted / period_s - 1.0) <= LARGEST_UNEVENNESS)
    return lasted, even, even | told, np.zeros(even.size, np.bool_)


def _by_the_device(recording: Recording, lasted_s: Array) -> tuple[Array, Mask]:
    """The device's own times where they came and can be believed, and where that is.

    What the host's stall delayed, the device did late: its times say so, and come back to the
    asks. Where they jump and stay away its clock was set, and the host's time counts.
    """
    never = np.zeros(lasted_s.size, np.bool_)
    if "device_time_us" not in recording:
        return lasted_s, never
    device = recording["device_time_us"]
    told = (device[1:] != MISSING) & (device[:-1] != MISSING)
    steps = np.where(told, np.diff(np.where(device == MISSING, 0, device)), 0)
    steps = (steps % DEVICE_WRAP_US) * 1e-6
    off = np.where(told, steps - lasted_s, 0.0)
    most = LARGEST_UNEVENNESS * recording.period_s
    away, walked = np.flatnonzero(np.abs(off) > most), np.cumsum(off)
    tick_s = float(np.gcd.reduce(np.rint(steps[told] * 1e6).astype(np.int64), initial=0)) * 1e-6
    fine = 0.0 < tick_s < COARSE * recording.period_s
    sound = away.size < (MOST_AWAY if fine else FEW_AWAY) * off.size
    if sound:
        stays = [abs(_later(walked, k) - _earlier(walked, k)) > most for k in away.tolist()]
        away = away[np.array(stays, np.bool_)]
    told[away] = False
    told &= steps >= 0.0
    return np.where(told, steps, lasted_s), told


def _earlier(walked: Array, k: int) -> float:
    return float(np.median(walked[max(k - STALL_ROWS, 0) : k])) if k else 0.0


def _later(walked: Array, k: int) -> float:
    return float(np.median(walked[min(k + 1, walked.size - 1) :][:STALL_ROWS]))


def _phases(recording: Recording, t_s: Array) -> tuple[Mask, Mask]:
    """Lead-in and identification are seen and the validation held out; else the last quarter.

    A rest before any motion is neither: where in its gap the load was left no command tells.
    """
    if "phase" in recording:
        phase = recording["phase"]
        seen = np.isin(phase, (Phase.LEAD_IN, Phase.IDENTIFICATION))
        held_out = phase == Phase.VALIDATION
        if held_out.any() and seen.any():
            return seen, held_out
    first_s = t_s[resting_rows(recording)]
    late = t_s >= first_s + (1.0 - HELD_OUT_SHARE) * (t_s[-1] - first_s)
    return ~late & (t_s >= first_s), late


def resting_rows(recording: Recording) -> int:
    """Rows before the first command to move; none where there is no command."""
    if "velocity_command_rad_s" not in recording or not len(recording):
        return 0
    return int(np.argmax(np.nan_to_num(recording["velocity_command_rad_s"]) != 0.0))
