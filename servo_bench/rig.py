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
from drivers.modbus import library as modbus_profiles
from drivers.modbus.lines import Line, RtuLine, TcpLine
from drivers.modbus.settings import LoadEncoder, ModbusDriveSettings, ModbusSettings
from servo_bench.errors import ConfigError, gathered
from servo_bench.files import Value, find, read_toml, validated
from sim_rig.model import Model
from sim_rig.settings import OWN_MODEL, Nominal, RigSettings

NodeId = Annotated[int, Field(ge=1, le=127)]
Interval = Annotated[float, Field(ge=0.001, le=60.0)]
"""What a drive can be told: whole milliseconds in 16 bits."""
EffectTables = dict[str, dict[str, float]]


class NominalConfig(Value):
    """`[nominal]`: what the data sheets say. See `sim_rig.settings.Nominal` for the symbols."""

    torque_constant_nm_per_a: PositiveFloat
    inertia_kg_m2: PositiveFloat
    proportional_gain_a_s_per_rad: PositiveFloat
    integral_gain_a_per_rad: PositiveFloat
    backlash_gap_rad: float = Field(default=0.0, ge=0.0)


class NodeConfig(Value):
    """What a drive and an encoder on CANopen have in common."""

    protocol: Literal["canopen"] = "canopen"
    node_id: NodeId
    eds: str
    vendor_id: int | None = None
    product_code: int | None = None
    counts_per_revolution: PositiveInt
    direction: Literal[1, -1] = 1

    def node_settings(self) -> NodeSettings:
        """The node for the drivers; ConfigError where its EDS cannot be found."""
        return NodeSettings(self.node_id, find(self.eds), self.vendor_id, self.product_code)


class SecondEncoderConfig(Value):
    """`[drive.second_encoder]`: the load's encoder where it hangs on the drive (0x60E4:sensor)."""

    counts_per_revolution: PositiveInt
    sensor: int = Field(default=1, ge=1, le=254)
    direction: Literal[1, -1] = 1


class DriveConfig(NodeConfig):
    """`[drive]`: the CiA 402 drive.

    `profile` names a drive profile (`servo-bench drives` lists them) or a TOML file of one;
    `without_watchdog` acknowledges a drive that does not stop by itself when the bench dies.
    `stuck_travel_rad` is how far the motor may turn before the load must have moved at all.
    """

    profile: str = GENERIC
    second_encoder: SecondEncoderConfig | None = None
    stuck_travel_rad: PositiveFloat = math.radians(10.0)
    gear_ratio: PositiveFloat = 1.0
    mode: Literal["csv", "pv"] = "csv"
    heartbeat_s: Interval = 0.1
    heartbeat_timeout_s: Interval = 0.3
    without_watchdog: bool = False
    enable_timeout_s: Interval = 2.0
    stop_timeout_s: Interval = 2.0
    sdo_timeout_s: Interval = 0.5

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


class ModbusDriveConfig(Value):
    """`[drive]` with protocol "modbus-tcp" or "modbus-rtu": a drive described by its register map.

    `[bus]` is host and port, or device, baud_rate, parity, and stop_bits. `profile` names a
    register map that ships, or a TOML file of one. `communication_timeout_s` is when the drive
    stops by itself; `without_watchdog` acknowledges that a drive cannot.
    """

    protocol: Literal["modbus-tcp", "modbus-rtu"]
    unit: int = Field(default=1, ge=1, le=247)
    profile: str = modbus_profiles.GENERIC
    counts_per_revolution: PositiveInt
    direction: Literal[1, -1] = 1
    gear_ratio: PositiveFloat = 1.0
    rated_torque_nm: PositiveFloat | None = None
    second_encoder: SecondEncoderConfig | None = None
    stuck_travel_rad: PositiveFloat = math.radians(10.0)
    communication_timeout_s: Interval = 0.3
    without_watchdog: bool = False
    enable_timeout_s: Interval = 2.0
    stop_timeout_s: Interval = 2.0

    def settings(self) -> ModbusDriveSettings:
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


class Limits(Value):
    """`[limits]`: checked before the drive is enabled and in every period after.

    Travel is the load's and the motor's distance from where the run began, to either side.
    `torque_nm` is the drive's own figure, and `drive_temperature_c` is asked of the drive once a
    second, where it has them. `blind_s` is the longest time without a slot played: cycles missed
    in a row, or a bus loop that hangs. `servo_bench.run.supervisor` watches all of them.
    """

    velocity_rad_s: PositiveFloat
    travel_rad: PositiveFloat
    run_time_s: PositiveFloat
    torque_nm: PositiveFloat | None = None
    drive_temperature_c: float | None = None
    blind_s: PositiveFloat = 0.2


class SimulatedConfig(Value):
    """`[simulated]`: only the software rig reads this; a real rig's file has no such table."""

    plant: str = OWN_MODEL
    seed: int = Field(default=0, ge=0)
    effects: EffectTables = Field(default_factory=dict)
    """What the software rig has besides, or instead of, the rig's own `[effects]`."""
    load_encoder_noise_rad: float = Field(default=0.0, ge=0.0)
    motor_encoder_noise_rad: float = Field(default=0.0, ge=0.0)
    rated_torque_nm: PositiveFloat = 0.64
    backlash_gap_rad: float | None = Field(default=None, ge=0.0)
    """The gap the software rig really has, where it differs from the nominal one."""
    faults: tuple[str, ...] = ()
    """Faults to order, one line each: see `sim_rig.faults.catalogue`."""


class RigConfig(Value):
    """One rig, whole."""

    name: str
    nominal: NominalConfig
    bus: dict[str, str | int | float | bool]
    drive: AnyDriveConfig
    encoder: EncoderConfig | None = None
    limits: Limits
    effects: EffectTables = Field(default_factory=dict)
    """`[effects.NAME]`: what the simulation of this rig has beyond its nominal values."""
    simulated: SimulatedConfig | None = None

    def nominal_values(self) -> Nominal:
        """The nominal rig in the simulation's own words."""
        return Nominal(**self.nominal.model_dump())

    def model(self) -> Model:
        """The simulation of this rig; ConfigError where an effect cannot be what it is told."""
        with gathered():
            return Model.from_table(self.nominal_values(), self.effects)

    def canopen_settings(self, period_s: float) -> CanopenSettings:
        """What the CANopen master needs to run this rig at `period_s`."""
        if isinstance(self.drive, ModbusDriveConfig):
            raise ConfigError(f"rig {self.name!r} has its drive on {self.drive.protocol}.")
        with gathered():
            return CanopenSettings(
                bus=self.bus,
                drive=self.drive.settings(),
                encoder=self.encoder.settings() if self.encoder else None,
                period_s=period_s,
                stuck_travel_rad=self.drive.stuck_travel_rad,
            )

    def modbus_settings(self, period_s: float) -> ModbusSettings:
        """What the Modbus master needs; ConfigError where the line cannot hold `period_s`."""
        drive = self.drive
        if not isinstance(drive, ModbusDriveConfig):
            raise ConfigError(f"rig {self.name!r} has its drive on {drive.protocol}.")
        if self.encoder is not None:
            raise ConfigError(
                "an [encoder] on CANopen beside a drive on Modbus would need a second bus, which a "
                "rig file does not have. Connect the encoder to the drive (drive.second_encoder)."
            )
        with gathered():
            return ModbusSettings(
                line=self._line(drive.protocol),
                drive=drive.settings(),
                period_s=period_s,
                stuck_travel_rad=drive.stuck_travel_rad,
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
                encoder_node_id=encoder.node_id if encoder else self._free_node_id(),
                load_counts_per_revolution=load.counts_per_revolution if load else 65536,
                plant=simulated.plant,
                effects=self.effects | simulated.effects if simulated.plant == OWN_MODEL else {},
                seed=simulated.seed,
                load_encoder_noise_rad=simulated.load_encoder_noise_rad,
                motor_encoder_noise_rad=simulated.motor_encoder_noise_rad,
                rated_torque_nm=simulated.rated_torque_nm,
                faults=simulated.faults,
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
        """The same rig on another bus, or on another port of it."""
        return self.model_copy(update={"bus": {**self.bus, **options}})


def load_rig(name: str | Path, beside: Path | None = None) -> RigConfig:
    """Read a rig file. Raises ConfigError where it is missing or says something impossible."""
    path = find(name, beside)
    return validated(RigConfig, read_toml(path), str(path))


def rig_from_table(table: dict[str, Any], source: str) -> RigConfig:
    """A rig that came with a recording."""
    return validated(RigConfig, table, source)
