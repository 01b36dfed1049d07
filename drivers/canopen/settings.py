"""What the master must be told about the drive and the encoder; all of it values."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from drivers.canopen.profile import DriveProfile, generic
from drivers.errors import SettingsError

BusOptions = Mapping[str, str | int | float | bool]
"""The keyword arguments of `can.Bus`: interface, channel, and what that interface wants."""


LEAST_BIT_RATE = 10_000
"""The slowest that CiA 301 knows."""


def bit_rate(options: BusOptions) -> int | None:
    """`bus.bitrate`, None where the rig file does not say it; SettingsError for what is none."""
    told = options.get("bitrate")
    if told is None:
        return None
    is_number = isinstance(told, int | float) and not isinstance(told, bool)
    if not is_number or not float(told).is_integer() or float(told) < LEAST_BIT_RATE:
        raise SettingsError(
            f"bus.bitrate = {told!r}: it is a whole number of bit/s, {LEAST_BIT_RATE} at the "
            "least. Write 500 kbit/s as bitrate = 500000."
        )
    return int(told)


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """A node on the bus and who it should be. An identity of None is not checked."""

    node_id: int
    eds: Path
    vendor_id: int | None = None
    product_code: int | None = None


@dataclass(frozen=True, slots=True)
class SecondEncoder:
    """The load's encoder where it hangs on the drive: object 0x60E4, sub-index `sensor`."""

    counts_per_revolution: int
    sensor: int = 1
    direction: Literal[1, -1] = 1


@dataclass(frozen=True, slots=True)
class DriveSettings:
    """A CiA 402 drive in a velocity mode; `profile` says what it does its own way.

    `counts_per_revolution` belongs to the motor encoder (0x6064 without scaling objects),
    `gear_ratio` is motor revolutions per revolution of the shaft that the bench calls motor angle
    (1 for a direct drive), `direction` is -1 where the drive counts against the bench.
    `without_watchdog` acknowledges a drive that does not stop by itself when the bench dies.
    """

    node: NodeSettings
    counts_per_revolution: int
    gear_ratio: float = 1.0
    direction: Literal[1, -1] = 1
    mode: Literal["csv", "pv"] = "csv"
    heartbeat_s: float = 0.1
    heartbeat_timeout_s: float = 0.3
    enable_timeout_s: float = 2.0
    stop_timeout_s: float = 2.0
    sdo_timeout_s: float = 0.5
    profile: DriveProfile = field(default_factory=generic)
    second_encoder: SecondEncoder | None = None
    without_watchdog: bool = False


@dataclass(frozen=True, slots=True)
class EncoderSettings:
    """A CiA 406 encoder behind the coupling; `direction` as for the drive."""

    node: NodeSettings
    counts_per_revolution: int
    direction: Literal[1, -1] = 1


@dataclass(frozen=True, slots=True)
class CanopenSettings:
    """One axis: bus, drive, load encoder (None where the rig has none), and the period.

    `period_s` is SYNC's, and a slot's. `command_every` slots share one set-point: SYNC at 1 ms
    and 8 sample an 8 ms command eight times. `sync_by_drive`: the drive produces SYNC, and this
    master follows. `stuck_travel_rad` is how far the motor may turn
    before the load must have moved at all, see `drivers.plausible`.
    Raises SettingsError for two load encoders, and for a bit rate that is none.
    """

    bus: BusOptions
    drive: DriveSettings
    encoder: EncoderSettings | None
    period_s: float
    master_node_id: int = 127
    answer_timeout_s: float = 0.25
    command_every: int = 1
    sync_by_drive: bool = False
    stuck_travel_rad: float = math.radians(10.0)

    def __post_init__(self) -> None:
        if self.encoder is not None and self.drive.second_encoder is not None:
            raise SettingsError(
                "the load's encoder is configured twice, on the bus ([encoder]) and on the drive "
                "(drive.second_encoder). Keep the one that sits behind the coupling."
            )
        if self.command_every < 1:
            raise SettingsError(f"command_every = {self.command_every}: one SYNC at the least.")
        bit_rate(self.bus)

    @property
    def command_period_s(self) -> float:
        """How long a set-point is held."""
        return self.period_s * self.command_every
