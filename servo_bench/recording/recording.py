"""A recording: what was commanded and what came back, slot by slot. Immutable.

A run on the wire, a simulation, and a file from elsewhere all end up as this value, so that a
diagnosis starts with a subtraction. Rows are slots in order; a slot that was skipped has no row,
which is a gap in `slot`. A value that did not come is NaN (floats) or `MISSING` (counts).

Channels of a run (others may have fewer; `t_s` and the command are always there):

    slot                    1      which period, counted from 0
    phase                   1      `servo_bench.excitation.experiment.Phase`
    chip                    1      place in its sequence, -1 outside
    asked_ns                ns     CLOCK_MONOTONIC at the ask (CANopen: the SYNC)
    device_time_us          us     the device's own sampling time, which begins again at 2^32
                                   (`DEVICE_WRAP_US`); MISSING without one
    velocity_command_rad_s  rad/s  acts from this slot's ask on; on a serial line from the request's
                                   last byte on (`RigConfig.command_after_s`)
    motor_position_rad      rad    `motor_sampled_s` after this slot's ask, as the next three
    motor_velocity_rad_s    rad/s  the drive's own figure
    motor_torque_nm         N m    the drive's own figure
    motor_current_a         A      the drive's own figure
    load_angle_rad          rad    `load_sampled_s` after this slot's ask
    motor_position_counts   1      raw, unwrapped
    load_angle_counts       1      raw, unwrapped
    lateness_s              s      wake-up after the slot's deadline
    drive_latency_s         s      ask -> drive's answer
    encoder_latency_s       s      ask -> encoder's answer
    motor_sampled_s         s      ask -> instant of the motor's angle: 0 where SYNC takes it
    load_sampled_s          s      ask -> instant of the load's angle; NaN where nobody knows
    statusword              1      CiA 402 0x6041

Data from elsewhere have `t_s` (seconds, as irregular as it came), the channels that were measured,
`run` where the file held several, and a `plant` instead of a rig; see docs/import.md.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servo_bench.excitation.experiment import Experiment
from servo_bench.recording.plant import ForeignPlant
from servo_bench.rig import RigConfig

MISSING = np.iinfo(np.int64).min
"""A count that did not come."""
DEVICE_WRAP_US = 1 << 32
"""Device times are those of CiA 301 object 0x1013: steps between them are taken modulo this."""

SAMPLE_FIELDS: tuple[tuple[str, str], ...] = (
    ("slot", "int64"),
    ("chip", "int64"),
    ("asked_ns", "int64"),
    ("device_time_us", "int64"),
    ("motor_position_counts", "int64"),
    ("load_angle_counts", "int64"),
    ("velocity_command_rad_s", "float64"),
    ("motor_position_rad", "float64"),
    ("motor_velocity_rad_s", "float64"),
    ("motor_torque_nm", "float64"),
    ("motor_current_a", "float64"),
    ("load_angle_rad", "float64"),
    ("lateness_s", "float64"),
    ("drive_latency_s", "float64"),
    ("encoder_latency_s", "float64"),
    ("motor_sampled_s", "float64"),
    ("load_sampled_s", "float64"),
    ("phase", "uint32"),
    ("statusword", "uint32"),
)
"""Name and type of every per-slot value, in the order in which a row holds them (no padding)."""

FAST_FIELDS: tuple[tuple[str, str], ...] = (
    ("slot", "int64"),
    ("asked_ns", "int64"),
    ("device_time_us", "int64"),
    ("motor_position_counts", "int64"),
    ("load_angle_counts", "int64"),
    ("motor_position_rad", "float64"),
    ("load_angle_rad", "float64"),
    ("motor_sampled_s", "float64"),
    ("load_sampled_s", "float64"),
    ("lateness_s", "float64"),
    ("part", "uint32"),
)
"""The same for each of the several samples that a slot can have; `part` counts from 0 in a slot."""


def _dtype(fields: tuple[tuple[str, str], ...]) -> "np.dtype[np.void]":
    return np.dtype([(name, f"<{np.dtype(kind).str[1:]}") for name, kind in fields])


SAMPLE_DTYPE = _dtype(SAMPLE_FIELDS)
FAST_DTYPE = _dtype(FAST_FIELDS)


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened beside the samples: a skipped slot, an emergency, the end.

    `time_ns` is CLOCK_MONOTONIC; `data` is whatever JSON the kind of event carries.
    """

    time_ns: int
    kind: str
    text: str
    data: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Channels, what was played, on which rig, and where it came from.

    `channels` maps a name to an array of shape (rows,), all alike in length and read-only: one row
    per command. `fast` does so for FAST_FIELDS where the angles were sampled several times per
    command (empty elsewhere), in the order of slot and part; part 0 is the slot's own row.
    `provenance` holds versions, host and clock facts as text. `cut` is true where the file ended
    before its run did.
    """

    channels: Mapping[str, NDArray[Any]]
    period_s: float
    experiment: Experiment | None
    rig: RigConfig | None
    provenance: Mapping[str, str]
    events: tuple[Event, ...] = ()
    cut: bool = False
    plant: ForeignPlant | None = None
    fast: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("channels", "fast"):
            table: Mapping[str, NDArray[Any]] = getattr(self, name)
            for array in table.values():
                array.setflags(write=False)
            object.__setattr__(self, name, MappingProxyType(dict(table)))

    def __getitem__(self, channel: str) -> NDArray[Any]:
        return self.channels[channel]

    def __contains__(self, channel: str) -> bool:
        return channel in self.channels

    def __len__(self) -> int:
        return len(next(iter(self.channels.values()), ()))


def recording_from_rows(  # the one way from a run's rows to the value
    rows: NDArray[np.void],
    experiment: Experiment,
    rig: RigConfig,
    provenance: Mapping[str, str],
    events: tuple[Event, ...] = (),
    *,
    cut: bool = False,
    fast: NDArray[np.void] | None = None,
) -> Recording:
    """A recording from rows of SAMPLE_DTYPE, shape (rows,), and of FAST_DTYPE where there are."""
    return Recording(
        channels=columns_of(rows),
        period_s=experiment.period_s,
        experiment=experiment,
        rig=rig,
        provenance=provenance,
        events=events,
        cut=cut,
        fast={} if fast is None or not fast.size else columns_of(fast),
    )


def columns_of(rows: NDArray[np.void]) -> dict[str, NDArray[Any]]:
    """Rows of a structured type as arrays by name, each of shape (rows,)."""
    return {name: np.ascontiguousarray(rows[name]) for name in rows.dtype.names or ()}
