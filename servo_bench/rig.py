"""The rig as its TOML file describes it: nominal values, bus, drive, encoder, limits, simulation.

`RigConfig` is the one place where a rig's numbers live; it hands the drivers and the software rig
their settings. Reader's units are accepted in every table (`backlash_gap_deg = 1.5`).
"""

import math
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, PositiveFloat, PositiveInt, Tag

from drivers.canopen.profile import GENERIC, load_profile
from drivers.canopen.settings import (
    CanopenSettings,
    DriveSettings,
    EncoderSettings,
    NodeSettings,
    SecondEncoder,
)
from drivers.counter import profile as counter_profiles
from drivers.counter.settings import CounterLine, CounterSettings
from drivers.modbus import library as modbus_profiles
from drivers.modbus.lines import Line, RtuLine, TcpLine
from drivers.modbus.settings import LoadEncoder, ModbusDriveSettings, ModbusSettings
from servo_bench.errors import ConfigError, gathered
from servo_bench.files import Value, find, read_toml, validated
from sim_rig.counter.settings import CounterSettings as SimulatedCounter
from sim_rig.model import Model
from sim_rig.settings import ENCODER_DEVICE, OWN_MODEL, Nominal, RigSettings

NodeId = Annotated[int, Field(ge=1, le=127)]
Interval = Annotated[float, Field(ge=0.001, le=60.0)]
"""What a drive can be told: whole milliseconds in 16 bits."""
EffectTables = dict[str, dict[str, float]]


class NominalConfig(Value):
    """`[nominal]`: what the data sheets say. See `sim_rig.settings.Nominal` for the symbols."""

    torque_constant_nm_per_a: PositiveFloat
    """Torque constant K_T of the motor, N m/A."""
    inertia_kg_m2: PositiveFloat
    """Inertia J that the motor turns, kg m²."""
    proportional_gain_a_s_per_rad: PositiveFloat
    """Proportional gain K_P of the velocity loop: current per velocity error, A s/rad."""
    integral_gain_a_per_rad: PositiveFloat
    """Integral gain K_I of the velocity loop: current per integrated velocity error, A/rad."""
    backlash_gap_rad: float = Field(default=0.0, ge=0.0)
    """Full width of the gap between motor and load, rad; 0 for none."""


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
    """Silence after which the master, or a node, counts as lost, s."""
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


class Limits(Value):
    """`[limits]`: checked before the drive is enabled and in every period after.

    `servo_bench.run.supervisor` watches all of them.
    """

    velocity_rad_s: PositiveFloat
    """Largest speed of the command, the motor, and the load, rad/s."""
    travel_rad: PositiveFloat
    """Largest distance of motor and load from where the run began, to either side, rad."""
    run_time_s: PositiveFloat
    """Longest run, s."""
    torque_nm: PositiveFloat | None = None
    """Largest torque that the drive may report, N m; where it reports one."""
    drive_temperature_c: float | None = None
    """Highest temperature that the drive may report, °C; asked once a second (Modbus: in every
    period)."""
    blind_s: PositiveFloat = 0.2
    """Longest time without a slot played, s: cycles missed in a row, or a bus loop that hangs. At
    least three periods are allowed."""


class SimulatedConfig(Value):
    """`[simulated]`: only the software rig reads this; a real rig's file has no such table."""

    plant: str = OWN_MODEL
    """What moves: "model", or `package.module:factory` of a plant of your own."""
    seed: int = Field(default=0, ge=0)
    """Seed of the encoders' noise and of what moves."""
    effects: EffectTables = Field(default_factory=dict)
    """What the software rig has besides, or instead of, the rig's own `[effects]`."""
    load_encoder_noise_rad: float = Field(default=0.0, ge=0.0)
    """White noise of the load's encoder before it is counted, rms, rad."""
    motor_encoder_noise_rad: float = Field(default=0.0, ge=0.0)
    """White noise of the motor's encoder before it is counted, rms, rad."""
    rated_torque_nm: PositiveFloat = 0.64
    """What torque per mille is of (0x6076), N m."""
    drive_temperature_c: float = 35.0
    """What the software rig's drive on Modbus says of its temperature, °C."""
    backlash_gap_rad: float | None = Field(default=None, ge=0.0)
    """The gap that the software rig really has, rad, where it differs from the nominal one."""
    faults: tuple[str, ...] = ()
    """Faults to order, one line each: see `sim_rig.faults.catalogue`."""


class RigConfig(Value):
    """One rig, whole."""

    name: str
    """What messages and recordings call the rig."""
    nominal: NominalConfig
    """What the data sheets say."""
    bus: dict[str, str | int | float | bool]
    """The wire: python-can's own options (`interface`, `channel`, ...), or those of a Modbus line.
    """
    drive: AnyDriveConfig
    """The drive."""
    encoder: AnyEncoderConfig | None = None
    """The load's encoder, where it does not hang on the drive."""
    limits: Limits
    """What no run may leave."""
    effects: EffectTables = Field(default_factory=dict)
    """`[effects.NAME]`: what the simulation of this rig has beyond its nominal values."""
    simulated: SimulatedConfig | None = None
    """How the software rig differs from the rig that the file describes."""

    def nominal_values(self) -> Nominal:
        """The nominal rig in the simulation's own words."""
        return Nominal(**self.nominal.model_dump())

    def model(self) -> Model:
        """The simulation of this rig; ConfigError where an effect cannot be what it is told."""
        with gathered():
            return Model.from_table(self.nominal_values(), self.effects)

    def canopen_settings(self, period_s: float) -> CanopenSettings:
        """What the CANopen master needs to run this rig with a command every `period_s`."""
        if isinstance(self.drive, ModbusDriveConfig):
            raise ConfigError(f"rig {self.name!r} has its drive on {self.drive.protocol}.")
        encoder = self.encoder
        if self.drive.sync == "drive" and isinstance(encoder, SerialEncoderConfig):
            raise ConfigError(
                'drive.sync = "drive" and an encoder on a serial line: the line is asked at this '
                "computer's pace, not at the drive's. Set drive.sync = \"master\"."
            )
        with gathered():
            return CanopenSettings(
                bus=self.bus,
                drive=self.drive.settings(),
                encoder=encoder.settings() if isinstance(encoder, EncoderConfig) else None,
                period_s=period_s / self.samples_per_command,
                command_every=self.samples_per_command,
                sync_by_drive=self.drive.sync == "drive",
                stuck_travel_rad=self.drive.stuck_travel_rad,
            )

    @property
    def samples_per_command(self) -> int:
        """How often the angles are sampled in a period of the command."""
        return self.drive.samples_per_command if isinstance(self.drive, DriveConfig) else 1

    def modbus_settings(self, period_s: float) -> ModbusSettings:
        """What the Modbus master needs; ConfigError where the line cannot hold `period_s`."""
        drive = self.drive
        if not isinstance(drive, ModbusDriveConfig):
            raise ConfigError(f"rig {self.name!r} has its drive on {drive.protocol}.")
        if isinstance(self.encoder, EncoderConfig):
            raise ConfigError(
                "an [encoder] on CANopen beside a drive on Modbus would need a second bus, which a "
                "rig file does not have. Connect the encoder to the drive (drive.second_encoder), "
                'or to a serial line (encoder.protocol = "serial").'
            )
        with gathered():
            return ModbusSettings(
                line=self._line(drive.protocol),
                drive=drive.settings(
                    limits_temperature=self.limits.drive_temperature_c is not None
                ),
                period_s=period_s,
                stuck_travel_rad=drive.stuck_travel_rad,
            )

    def command_after_s(self, period_s: float) -> float:
        """From a slot's ask until the drive has its command: zero but on a serial line.

        ConfigError where the drive's profile is not at hand, or the line cannot hold `period_s`.
        """
        if not isinstance(self.drive, ModbusDriveConfig):
            return 0.0
        return self.modbus_settings(period_s).command_after_s

    def counter_settings(self, period_s: float) -> CounterSettings | None:
        """What the serial counter needs; None without one.

        ConfigError where its line cannot hold `period_s`, or the load has a second encoder.
        """
        encoder = self.encoder
        if not isinstance(encoder, SerialEncoderConfig):
            return None
        if self.drive.second_encoder is not None:
            raise ConfigError(
                "the load's encoder is configured twice, on a serial line ([encoder]) and on the "
                "drive (drive.second_encoder). Keep the one that sits behind the coupling."
            )
        if encoder.device == self.bus.get("device"):
            raise ConfigError(
                f"encoder.device = {encoder.device!r} is the drive's line (bus.device): a serial "
                "counter needs a line of its own."
            )
        with gathered():
            return CounterSettings(
                line=encoder.line(),
                profile=encoder.framing(),
                counts_per_revolution=encoder.counts_per_revolution,
                period_s=period_s / self.samples_per_command,
                fastest_rad_s=self.limits.velocity_rad_s,
                direction=encoder.direction,
                stuck_travel_rad=self.drive.stuck_travel_rad,
            )

    def _line(self, protocol: str) -> Line:
        kind: type[Line] = TcpLine if protocol == "modbus-tcp" else RtuLine
        allowed = {field.name for field in fields(kind)}
        options: dict[str, Any] = {k: v for k, v in self.bus.items() if k != "turnaround_s"}
        unknown, allowed_text = set(options) - allowed, ", ".join(sorted(allowed))
        if unknown:
            raise ConfigError(
                f"[bus] of a drive on {protocol} has no {min(unknown)}. It takes {allowed_text}."
            )
        try:
            return kind(**options)
        except TypeError as error:
            raise ConfigError(
                f"[bus] of a drive on {protocol}: {error}. It takes {allowed_text}."
            ) from error

    def simulation_settings(self) -> RigSettings:
        """What the software rig needs to stand in for this rig."""
        simulated = self.simulated or SimulatedConfig()
        nominal = self.nominal.model_dump()
        if simulated.backlash_gap_rad is not None:
            nominal["backlash_gap_rad"] = simulated.backlash_gap_rad
        encoder = self.encoder
        load = encoder or self.drive.second_encoder
        with gathered():
            return RigSettings(
                nominal=Nominal(**nominal),
                bus=self.bus,
                protocol=self.drive.protocol,
                drive_node_id=(
                    self.drive.unit
                    if isinstance(self.drive, ModbusDriveConfig)
                    else self.drive.node_id
                ),
                motor_counts_per_revolution=self.drive.counts_per_revolution,
                encoder_node_id=(
                    encoder.node_id if isinstance(encoder, EncoderConfig) else self._free_node_id()
                ),
                load_counts_per_revolution=load.counts_per_revolution if load else 65536,
                plant=simulated.plant,
                effects=self.effects | simulated.effects if simulated.plant == OWN_MODEL else {},
                seed=simulated.seed,
                load_encoder_noise_rad=simulated.load_encoder_noise_rad,
                motor_encoder_noise_rad=simulated.motor_encoder_noise_rad,
                rated_torque_nm=simulated.rated_torque_nm,
                drive_temperature_c=simulated.drive_temperature_c,
                faults=simulated.faults,
                counter=self._simulated_counter(),
            )

    def _simulated_counter(self) -> SimulatedCounter | None:
        encoder = self.encoder
        if not isinstance(encoder, SerialEncoderConfig):
            return None
        profile, line = encoder.framing(), encoder.line()
        return SimulatedCounter(
            framing=encoder.profile,
            counts_per_revolution=encoder.counts_per_revolution,
            baud_rate=encoder.baud_rate,
            character_bits=round(line.character_s * line.baud_rate),
            turnaround_s=profile.timing.turnaround_s,
            modulus=profile.range,
        )

    def _free_node_id(self) -> int:
        """A node id beside the drive's: the software rig has an encoder's node in any case."""
        drive = self.drive
        taken = drive.unit if isinstance(drive, ModbusDriveConfig) else drive.node_id
        return 2 if taken != 2 else 1

    def with_faults(self, *faults: str) -> "RigConfig":
        """The same rig, its software stand-in with these faults besides its own."""
        simulated = self.simulated or SimulatedConfig()
        wanted = simulated.model_copy(update={"faults": (*simulated.faults, *faults)})
        return self.model_copy(update={"simulated": wanted})

    def on_a_free_port(self) -> "RigConfig":
        """The same rig, its software stand-in choosing a free port, where the bus has one."""
        return self.with_bus(port=0) if "port" in self.bus else self

    def with_bus(self, **options: str | int | float | bool) -> "RigConfig":
        """The same rig on another bus, or on another port of it.

        `encoder_device`, which the software rig tells with its bus, is where a serial encoder is.
        """
        device = options.pop(ENCODER_DEVICE, None)
        changed: dict[str, Any] = {"bus": {**self.bus, **options}}
        if device is not None and isinstance(self.encoder, SerialEncoderConfig):
            changed["encoder"] = self.encoder.model_copy(update={"device": str(device)})
        return self.model_copy(update=changed)


def load_rig(name: str | Path, beside: Path | None = None) -> RigConfig:
    """Read a rig file. Raises ConfigError where it is missing or says something impossible."""
    path = find(name, beside)
    return validated(RigConfig, read_toml(path), str(path))


def rig_from_table(table: dict[str, Any], source: str) -> RigConfig:
    """A rig that came with a recording."""
    return validated(RigConfig, table, source)
