"""From the rows of a recording to a response on an unbroken grid of slots.

The response is the load's velocity over one slot,

    y(k) = (angle(k + 1) - angle(k)) / period_s        [rad/s]

for the angle itself carries an integrator and has no kernel that decays. Slot k's angle is taken
at its ask, before its command acts, so y(k) is the first that the command of slot k can reach:
lag 0 means the command of the same slot.

Where the device tells its sampling times, the increment is divided by the time that really passed
between the two samples; the command acts at the jittering asks too, and on simulated jitter of
0.2 to 2 ms this came closer to the punctual response than the nominal period did (variance missed
0.31 instead of 0.40 %, 8.1 instead of 11.3 %).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import RecordingError
from servo_bench.excitation.experiment import Phase
from servo_bench.recording.recording import DEVICE_WRAP_US, MISSING, Recording

Array = NDArray[np.float64]
Timebase = Literal["device", "nominal"]

LARGEST_MISSING_SHARE = 0.01
"""Above this share of missing angles a recording is refused."""

LARGEST_UNEVENNESS = 0.25
"""A slot that lasted longer or shorter by more than this share of the period is disturbed."""

SHORTEST_SLOT = 0.1
"""Increments are divided by no less than this share of the period."""


MOST_PERIODS = 1 << 40
"""No recording is longer; and what is sparser than `SPARSEST` of its slots is none of one run."""
SPARSEST = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """What was commanded and answered in every slot from the first to the last; arrays (slots,).

    `velocity_rad_s` has one entry less: the increment from each slot to the next. Angles that did
    not come are bridged linearly; a slot that was skipped kept the command before it. `disturbed`,
    of the same length, marks the increments that are not what one period of one command gives:
    an end was bridged, or the slot lasted much longer or shorter than a period.
    """

    period_s: float
    command_rad_s: Array
    phase: NDArray[np.int64]
    angle_rad: Array
    velocity_rad_s: Array
    disturbed: NDArray[np.bool_]
    missing_slots: int
    missing_angles: int
    timebase: Timebase

    def slots_of(self, phase: Phase) -> slice:
        """The slots of one phase, as a slice."""
        found = np.flatnonzero(self.phase == phase)
        return slice(int(found[0]), int(found[-1]) + 1) if found.size else slice(0, 0)


def response_of(recording: Recording) -> Response:
    """The response of a recording.

    Raises RecordingError without the channels it takes, with angles that never came, or with more
    than 1 % of them missing.
    """
    rows = _rows(recording)
    slots = int(rows[-1]) + 1
    present = np.zeros(slots, np.bool_)
    present[rows] = True
    newest = np.maximum.accumulate(np.where(present, np.cumsum(present) - 1, 0))
    known_angle = np.zeros(slots, np.bool_)
    known_angle[rows] = np.isfinite(recording["load_angle_rad"])
    _check_gaps(known_angle)
    places = np.flatnonzero(known_angle)
    angle = np.interp(
        np.arange(slots), places, recording["load_angle_rad"][newest[places]].astype(np.float64)
    )
    duration_s, timebase = _durations(recording, rows, slots)
    lasted_s = duration_s if timebase == "device" else _between_asks(recording, rows, slots)
    uneven = np.abs(lasted_s / recording.period_s - 1.0) > LARGEST_UNEVENNESS
    return Response(
        period_s=recording.period_s,
        command_rad_s=recording["velocity_command_rad_s"][newest].astype(np.float64),
        phase=_phases(recording, newest, slots),
        angle_rad=angle,
        velocity_rad_s=np.diff(angle) / duration_s,
        disturbed=uneven | ~known_angle[1:] | ~known_angle[:-1],
        missing_slots=slots - rows.size,
        missing_angles=slots - places.size,
        timebase=timebase,
    )


def _rows(recording: Recording) -> NDArray[np.int64]:
    """The slot of every row, counted from the first one; RecordingError where there is none."""
    for channel, remedy in (
        ("velocity_command_rad_s", "Record the command."),
        ("load_angle_rad", "Record on a rig with an [encoder] behind the coupling."),
    ):
        if channel not in recording:
            raise RecordingError(
                f"the recording has no channel {channel}: it has "
                f"{', '.join(sorted(recording.channels)) or 'none'}. {remedy}"
            )
    slot = slot_numbers(recording)
    if slot.size < 2:
        raise RecordingError(
            f"the recording has {slot.size} rows: nothing can be estimated from fewer than a "
            f"period of its sequence. Record it to its end."
        )
    if (np.diff(slot) < 1).any():
        row = int(np.flatnonzero(np.diff(slot) < 1)[0]) + 1
        raise RecordingError(
            f"row {row} of the recording is slot {slot[row]} after slot {slot[row - 1]}: slots "
            f"must rise. The file is damaged or was joined from two runs; use one run."
        )
    counted: NDArray[np.int64] = slot - slot[0]
    if slot.size < SPARSEST * counted[-1]:
        row = int(np.argmax(np.diff(slot))) + 1
        raise RecordingError(
            f"the recording's {slot.size} rows span {counted[-1] + 1} slots: row {row} is slot "
            f"{slot[row]} after slot {slot[row - 1]}. A slot number or a time is wild, or two runs "
            "were joined; use one run."
        )
    return counted


def slot_numbers(recording: Recording) -> NDArray[np.int64]:
    """The slot of each row; where it is not told, from `t_s`, and without that row by row."""
    if "slot" in recording:
        slot: NDArray[np.int64] = recording["slot"].astype(np.int64)
        return slot
    if "t_s" in recording:
        return _periods(recording["t_s"].astype(np.float64), recording.period_s)
    return np.arange(len(recording), dtype=np.int64)


def _periods(t_s: Array, period_s: float) -> NDArray[np.int64]:
    """Times in periods, counted from the first: wherever between two that lies, rows that jitter
    stay apart."""
    if not np.isfinite(t_s).all():
        row = int(np.flatnonzero(~np.isfinite(t_s))[0])
        raise RecordingError(f"the time of row {row} is {t_s[row]}. Mend the file, or cut it out.")
    begin_s = float(t_s[0]) if t_s.size else 0.0
    passed = np.rint((t_s - begin_s) / period_s)
    if passed.size and np.abs(passed).max() > MOST_PERIODS:
        raise RecordingError(
            f"the recording's times span {np.ptp(t_s):.3g} s, {np.abs(passed).max():.3g} periods "
            f"of {period_s:g} s: at most {MOST_PERIODS} can be. Look for a row whose time is wild."
        )
    counted: NDArray[np.int64] = passed.astype(np.int64) + round(begin_s / period_s)
    return counted


def _check_gaps(known: NDArray[np.bool_]) -> None:
    missing = int(known.size - np.count_nonzero(known))
    if missing == known.size:
        raise RecordingError(
            f"not one of {known.size} load angles came. Check the encoder and its node, and "
            f"record again."
        )
    if missing > LARGEST_MISSING_SHARE * known.size:
        raise RecordingError(
            f"{missing} of {known.size} load angles are missing "
            f"({100.0 * missing / known.size:.1f} %): at most "
            f"{100.0 * LARGEST_MISSING_SHARE:.0f} % can be bridged. Look at the run's missed slots "
            f"and missing answers, and record again on a quieter machine or bus."
        )


def _phases(recording: Recording, newest: NDArray[np.intp], slots: int) -> NDArray[np.int64]:
    """The phase of every slot: as scheduled, or where no schedule came, as its last row says."""
    if recording.experiment is not None:
        scheduled: NDArray[np.int64] = recording.experiment.schedule().phase.astype(np.int64)
        first = int(slot_numbers(recording)[0])
        if first >= 0 and first + slots <= scheduled.size:
            return scheduled[first : first + slots]
    if "phase" not in recording:
        raise RecordingError(
            "the recording says neither its experiment nor the phase of each slot, so its "
            "identification period cannot be found. Use a recording of the bench, or convert "
            "yours with a channel `phase`."
        )
    told: NDArray[np.int64] = recording["phase"].astype(np.int64)
    phases: NDArray[np.int64] = told[newest]
    if "chip" in recording:  # a phase whose first slots were skipped began chip slots earlier
        rows = _rows(recording)
        for row in np.flatnonzero(np.diff(told)) + 1:
            began = max(rows[row] - recording["chip"][row], rows[row - 1] + 1)
            phases[began : rows[row]] = told[row]
    return phases


def _durations(recording: Recording, rows: NDArray[np.int64], slots: int) -> tuple[Array, Timebase]:
    """How long each slot lasted between its two samples, by the device's clock if it tells.

    A device's clock may run fast or slow against the host's: its median slot is the period. A
    slot without a time of its own lasted one period.
    """
    times = recording["device_time_us"] if "device_time_us" in recording else np.zeros(0, np.int64)
    neighbours = np.diff(rows) == 1
    nominal = np.full(slots - 1, recording.period_s)
    if not times.size or (times == MISSING).mean() > LARGEST_MISSING_SHARE:
        return nominal, "nominal"
    told = (times[1:] != MISSING) & (times[:-1] != MISSING) & neighbours
    lasted = (np.diff(times)[told] % DEVICE_WRAP_US).astype(np.float64)
    median = float(np.median(lasted)) if lasted.size else 0.0
    if median <= 0.0:
        return nominal, "nominal"
    duration = nominal.copy()
    duration[rows[:-1][told]] *= np.maximum(lasted / median, SHORTEST_SLOT)
    return duration, "device"


def _between_asks(recording: Recording, rows: NDArray[np.int64], slots: int) -> Array:
    """How long each slot lasted by the host's clock; the period where it is not told."""
    lasted = np.full(slots - 1, recording.period_s)
    if "asked_ns" in recording:
        asked_ns = recording["asked_ns"]
        came = asked_ns != MISSING
        told = (np.diff(rows) == 1) & came[1:] & came[:-1]
        lasted[rows[:-1][told]] = np.diff(asked_ns)[told] * 1e-9
    return lasted
