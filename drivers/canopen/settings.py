"""What the master must be told about the drive and the encoder; all of it values."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

BusOptions = Mapping[str, str | int | float | bool]
"""The keyword arguments of `can.Bus`: interface, channel, and what that interface wants."""


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """A node on the bus and who it should be. An identity of None is not checked."""

    node_id: int
    eds: Path
    vendor_id: int | None = None
    product_code: int | None = None


@dataclass(frozen=True, slots=True)
class DriveSettings:
    """A CiA 402 drive in a velocity mode.

    `counts_per_revolution` belongs to the motor encoder (0x6064 without scaling objects),
    `gear_ratio` is motor revolutions per revolution of the shaft that the bench calls motor angle
    (1 for a direct drive), `direction` is -1 where the drive counts against the bench.
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


@dataclass(frozen=True, slots=True)
class EncoderSettings:
    """A CiA 406 encoder behind the coupling; `direction` as for the drive."""

    node: NodeSettings
    counts_per_revolution: int
    direction: Literal[1, -1] = 1


@dataclass(frozen=True, slots=True)
class CanopenSettings:
    """One axis: bus, drive, load encoder (None where the rig has none), and the period."""

    bus: BusOptions
    drive: DriveSettings
    encoder: EncoderSettings | None
    period_s: float
    master_node_id: int = 127
    answer_timeout_s: float = field(default=0.25)
