"""The devices of a rig file: `[drive]` and `[encoder]`, and which kind of each a table is.

Every one hands the drivers its settings; the profile or EDS that it names is read then, not before.
"""

import math
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, PositiveFloat, PositiveInt, Tag

from drivers.canopen.profile import GENERIC, load_profile
from drivers.canopen.settings import DriveSettings, EncoderSettings, NodeSettings, SecondEncoder
from drivers.counter import profile as counter_profiles
from drivers.counter.settings import CounterLine
from drivers.modbus import library as modbus_profiles
from drivers.modbus.settings import LoadEncoder, ModbusDriveSettings
from servo_bench.errors import gathered
from servo_bench.files import Value, find

NodeId = Annotated[int, Field(ge=1, le=127)]
Interval = Annotated[float, Field(ge=0.001, le=60.0)]
"""What a drive can be told: whole milliseconds in 16 bits."""


class NodeConfig(Value):
    """What a drive and an encoder on CANopen have in common."""

    protocol: Literal["canopen"] = "canopen"
    """How it is spoken to."""
    node_id: NodeId
    """Its CANopen node id."""
    eds: str
    """Its EDS: a file that ships, or a path."""
    vendor_id: int | None = None
    """What 0x1018:1 must say; by default the drive profile's, if it names one, else anything."""
    product_code: int | None = None
    """What 0x1018:2 must say; by default anything."""
    counts_per_revolution: PositiveInt
    """Encoder counts in one turn of its shaft."""
    direction: Literal[1, -1] = 1
    """-1 where it counts against the bench's positive sense."""

    def node_settings(self) -> NodeSettings:
        """The node for the drivers; ConfigError where its EDS cannot be found."""
        return NodeSettings(self.node_id, find(self.eds), self.vendor_id, self.product_code)


class SecondEncoderConfig(Value):
    """`[drive.second_encoder]`: the load's encoder where it hangs on the drive (0x60E4:sensor)."""

    counts_per_revolution: PositiveInt
    """Counts in one turn of the load."""
    sensor: int = Field(default=1, ge=1, le=254)
    """CANopen: the sub-index of 0x60E4; Modbus: not used."""
    direction: Literal[1, -1] = 1
    """-1 where it counts against the bench's positive sense."""


class DriveConfig(NodeConfig):
    """`[drive]`: the CiA 402 drive."""

    profile: str = GENERIC
    """A drive profile that ships (`servo-bench drives` lists them), or a TOML file of one."""
    sync: Literal["master", "drive"] = "master"
    """Who produces SYNC; the drive only where its profile says that it can."""
    samples_per_command: int = Field(default=1, ge=1, le=64)
    """So many SYNCs, each with a sample of the angles, in a period of the command (1 ms in 8 ms:
    8)."""
    second_encoder: SecondEncoderConfig | None = None
    """The load's encoder where it hangs on the drive."""
    stuck_travel_rad: PositiveFloat = math.radians(10.0)
    """How far the motor may turn before the load must have moved at all, rad."""
    torque_filter_s: float = Field(default=0.0, ge=0.0, le=1.0)
    """Time constant of the low pass through which a real drive tells its torque, s; 0 without one.
    The software rig has none."""
    gear_ratio: PositiveFloat = 1.0
    """Motor revolutions in one of the shaft that the bench calls motor angle; 1 without a gear."""
    mode: Literal["csv", "pv"] = "csv"
    """Cyclic synchronous velocity ("csv"), or profile velocity ("pv", shaped by the drive's ramps).
    """
    heartbeat_s: Interval = 0.1
    """How often master and nodes send their heartbeat, s (node guarding: the guard time)."""
    heartbeat_timeout_s: Interval = 0.3
    """Silence after which the master, or a node, counts as lost, s; longer than `heartbeat_s`."""
    without_watchdog: bool = False
    """Acknowledges a drive that does not stop by itself when the bench dies."""
    enable_timeout_s: Interval = 2.0
    """How long nodes may take to become operational, and the drive to be enabled, s."""
    stop_timeout_s: Interval = 2.0
    """How long the quick stop may take before the drive is switched off all the same, s."""
    sdo_timeout_s: Interval = 0.5
    """How long the answer to an SDO request may take, s."""

    def settings(self) -> DriveSettings:
        """The drive for the drivers; ConfigError where its EDS or profile cannot be found."""
        own = self.profile.endswith(".toml")
        with gathered():
            profile = load_profile(str(find(self.profile)) if own else self.profile)
        second = self.second_encoder
        return DriveSettings(
            node=self.node_settings(),
            counts_per_revolution=self.counts_per_revolution,
            gear_ratio=self.gear_ratio,
            direction=self.direction,
            mode=self.mode,
            heartbeat_s=self.heartbeat_s,
            heartbeat_timeout_s=self.heartbeat_timeout_s,
            enable_timeout_s=self.enable_timeout_s,
            stop_timeout_s=self.stop_timeout_s,
            sdo_timeout_s=self.sdo_timeout_s,
            profile=profile,
            second_encoder=SecondEncoder(**second.model_dump()) if second else None,
            without_watchdog=self.without_watchdog,
        )


class EncoderConfig(NodeConfig):
    """`[encoder]`: the CiA 406 encoder behind the coupling."""

    def settings(self) -> EncoderSettings:
        """The encoder for the drivers; ConfigError where its EDS cannot be found."""
        return EncoderSettings(self.node_settings(), self.counts_per_revolution, self.direction)


class SerialEncoderConfig(Value):
    """`[encoder]` with protocol "serial": a counter box on a line of its own, beside any drive."""

    protocol: Literal["serial"]
    """A counter on a serial line of its own."""
    device: str
    """The serial device, e.g. `/dev/ttyUSB1`."""
    baud_rate: PositiveInt = 115200
    """The line's speed, Bd."""
    profile: str = counter_profiles.GENERIC
    """A framing that ships (`servo-bench drives` lists them), or a TOML file of one."""
    data_bits: Literal[7, 8] | None = None
    """Data bits of a character; by default the profile's."""
    parity: Literal["N", "E", "O"] | None = None
    """Parity of a character: none, even, odd; by default the profile's."""
    stop_bits: Literal[1, 2] | None = None
    """Stop bits of a character; by default the profile's."""
    counts_per_revolution: PositiveInt
    """Counts in one turn of the load."""
    direction: Literal[1, -1] = 1
    """-1 where it counts against the bench's positive sense."""

    def framing(self) -> counter_profiles.CounterProfile:
        """The profile; ConfigError where it cannot be found or used."""
        own = self.profile.endswith(".toml")
        with gathered():
            return counter_profiles.load_profile(str(find(self.profile)) if own else self.profile)

    def line(self) -> CounterLine:
        """The line for the drivers."""
        usual = self.framing().line
        return CounterLine(
            device=self.device,
            baud_rate=self.baud_rate,
            data_bits=self.data_bits or usual.data_bits,
            parity=self.parity or usual.parity,
            stop_bits=self.stop_bits or usual.stop_bits,
        )


class ModbusDriveConfig(Value):
    """`[drive]` with protocol "modbus-tcp" or "modbus-rtu": a drive described by its register map.

    `[bus]` is host and port, or device, baud_rate, parity, and stop_bits.
    """

    protocol: Literal["modbus-tcp", "modbus-rtu"]
    """Which Modbus the drive speaks; the profile must have it."""
    unit: int = Field(default=1, ge=1, le=247)
    """The drive's unit id."""
    profile: str = modbus_profiles.GENERIC
    """A register map that ships (`servo-bench drives` lists them), or a TOML file of one."""
    counts_per_revolution: PositiveInt
    """Encoder counts in one turn of the motor."""
    direction: Literal[1, -1] = 1
    """-1 where the drive counts against the bench's positive sense."""
    gear_ratio: PositiveFloat = 1.0
    """Motor revolutions in one of the shaft that the bench calls motor angle; 1 without a gear."""
    rated_torque_nm: PositiveFloat | None = None
    """Rated torque, N m: for a drive that tells torque per mille and has no register of it."""
    second_encoder: SecondEncoderConfig | None = None
    """The load's encoder where it hangs on the drive."""
    stuck_travel_rad: PositiveFloat = math.radians(10.0)
    """How far the motor may turn before the load must have moved at all, rad."""
    torque_filter_s: float = Field(default=0.0, ge=0.0, le=1.0)
    """Time constant of the low pass through which a real drive tells its torque, s; 0 without one.
    The software rig has none."""
    communication_timeout_s: Interval = 0.3
    """Silence after which the drive stops by itself, s; rounded up to its steps."""
    without_watchdog: bool = False
    """Acknowledges a drive that does not stop by itself when the bench dies."""
    enable_timeout_s: Interval = 2.0
    """How long all steps until the drive is enabled may take, s."""
    stop_timeout_s: Interval = 2.0
    """How long the drive may take to stop, and again to switch off, s."""

    def settings(self, *, limits_temperature: bool = False) -> ModbusDriveSettings:
        """The drive for the drivers; ConfigError where its profile cannot be found or used."""
        own = self.profile.endswith(".toml")
        with gathered():
            profile = modbus_profiles.load_profile(str(find(self.profile)) if own else self.profile)
        second = self.second_encoder
        return ModbusDriveSettings(
            unit=self.unit,
            profile=profile,
            counts_per_revolution=self.counts_per_revolution,
            gear_ratio=self.gear_ratio,
            direction=self.direction,
            rated_torque_nm=self.rated_torque_nm,
            load=LoadEncoder(second.counts_per_revolution, second.direction) if second else None,
            communication_timeout_s=self.communication_timeout_s,
            without_watchdog=self.without_watchdog,
            enable_timeout_s=self.enable_timeout_s,
            stop_timeout_s=self.stop_timeout_s,
            limits_temperature=limits_temperature,
        )


def _protocol(drive: Any) -> str:
    """Which kind of `[drive]` a table or a value is."""
    protocol = (
        drive.get("protocol", "canopen")
        if isinstance(drive, dict)
        else getattr(drive, "protocol", "")
    )
    return "modbus" if str(protocol).startswith("modbus") else "canopen"


AnyDriveConfig = Annotated[
    Annotated[DriveConfig, Tag("canopen")] | Annotated[ModbusDriveConfig, Tag("modbus")],
    Discriminator(_protocol),
]


def _encoder_kind(encoder: Any) -> str:
    """Which kind of `[encoder]` a table or a value is."""
    protocol = (
        encoder.get("protocol") if isinstance(encoder, dict) else getattr(encoder, "protocol", "")
    )
    return "serial" if protocol == "serial" else "canopen"


AnyEncoderConfig = Annotated[
    Annotated[EncoderConfig, Tag("canopen")] | Annotated[SerialEncoderConfig, Tag("serial")],
    Discriminator(_encoder_kind),
]
