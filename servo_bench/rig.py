"""The rig as its TOML file describes it: nominal values, bus, drive, encoder, limits, simulation.

`RigConfig` is the one place where a rig's numbers live; it hands the drivers and the software rig
their settings. Reader's units are accepted in every table (`backlash_gap_deg = 1.5`).
"""

import math
from dataclasses import fields
from pathlib import Path
from typing import Any, Self

from pydantic import Field, PositiveFloat, model_validator

from drivers.canopen.guarding import guard_times
from drivers.canopen.settings import CanopenSettings, DriveSettings
from drivers.counter.settings import CounterSettings
from drivers.modbus.lines import Line, RtuLine, TcpLine
from drivers.modbus.settings import ModbusSettings
from servo_bench.devices import (
    AnyDriveConfig,
    AnyEncoderConfig,
    DriveConfig,
    EncoderConfig,
    ModbusDriveConfig,
    SerialEncoderConfig,
)
from servo_bench.errors import ConfigError, gathered
from servo_bench.files import Value, find, read_toml, validated
from sim_rig.counter.settings import CounterSettings as SimulatedCounter
from sim_rig.model import Model
from sim_rig.settings import ENCODER_DEVICE, OWN_MODEL, Nominal, RigSettings

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
    """What the software rig has besides, or instead of, the rig's own `[effects]`; not beside a
    plant of your own, which has neither."""
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

    @model_validator(mode="after")
    def _two_nodes(self) -> Self:
        ids = [
            device.node_id
            for device in (self.drive, self.encoder)
            if isinstance(device, DriveConfig | EncoderConfig)
        ]
        if len(set(ids)) < len(ids):
            raise ValueError(
                f"drive.node_id and encoder.node_id are both {ids[0]}: give each node of the bus "
                "an id of its own, 1 to 127"
            )
        return self

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
        drive = self.drive.settings()
        _check_timeout(drive, period_s)
        with gathered():
            return CanopenSettings(
                bus=self.bus,
                drive=drive,
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

    @property
    def load_counts_per_revolution(self) -> int | None:
        """Of the encoder behind the coupling, on whatever line; None where the rig has none."""
        load = self.encoder or self.drive.second_encoder
        return load.counts_per_revolution if load else None

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
                load_counts_per_revolution=self.load_counts_per_revolution or 65536,
                plant=simulated.plant,
                effects=(self.effects if simulated.plant == OWN_MODEL else {}) | simulated.effects,
                seed=simulated.seed,
                load_encoder_noise_rad=simulated.load_encoder_noise_rad,
                motor_encoder_noise_rad=simulated.motor_encoder_noise_rad,
                rated_torque_nm=simulated.rated_torque_nm,
                drive_temperature_c=simulated.drive_temperature_c,
                faults=simulated.faults,
                counter=self._simulated_counter(),
                gear_ratio=self.drive.gear_ratio,
                motor_direction=self.drive.direction,
                load_direction=load.direction if load else 1,
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

    def as_simulated(self, **bus: str | int | float | bool) -> "RigConfig":
        """The rig that its software stand-in is, on the bus that it told: no filter is in front of
        its torque."""
        drive = self.drive.model_copy(update={"torque_filter_s": 0.0})
        return self.with_bus(**bus).model_copy(update={"drive": drive})

    def with_bus(self, **options: str | int | float | bool) -> "RigConfig":
        """The same rig on another bus, or on another port of it.

        `encoder_device`, which the software rig tells with its bus, is where a serial encoder is.
        """
        device = options.pop(ENCODER_DEVICE, None)
        changed: dict[str, Any] = {"bus": {**self.bus, **options}}
        if device is not None and isinstance(self.encoder, SerialEncoderConfig):
            changed["encoder"] = self.encoder.model_copy(update={"device": str(device)})
        return self.model_copy(update=changed)


def _check_timeout(drive: DriveSettings, period_s: float) -> None:
    """Raise ConfigError where the drive must take a master that lives for lost."""
    timeout_s, word_s = drive.heartbeat_timeout_s, drive.heartbeat_s
    remedy = "lower drive.heartbeat_s"
    match drive.profile.stopping.watchdog:
        case "heartbeat":
            words = f"heartbeats (drive.heartbeat_s = {word_s:g}"
        case "node-guarding":
            guard_ms, _ = guard_times(word_s, timeout_s)
            word_s, remedy = guard_ms * 1e-3, "shorten the period"
            words = f"node guarding's questions (guard time 0x100C = {guard_ms} ms"
        case "rpdo-timer":
            word_s, remedy = period_s, "shorten the period"
            words = "commands (0x1400:5 awaits them"
        case _:
            return
    every_s = period_s * math.ceil(word_s / period_s)
    if timeout_s <= every_s:
        raise ConfigError(
            f"drive.heartbeat_timeout_s = {timeout_s:g} s, and {words}, each with a command) go "
            f"out every {every_s:g} s: the drive would take its master for lost. Raise "
            f"drive.heartbeat_timeout_s, or {remedy}."
        )


def load_rig(name: str | Path, beside: Path | None = None) -> RigConfig:
    """Read a rig file. Raises ConfigError where it is missing or says something impossible."""
    path = find(name, beside)
    return validated(RigConfig, read_toml(path), str(path))


def rig_from_table(table: dict[str, Any], source: str) -> RigConfig:
    """A rig that came with a recording."""
    return validated(RigConfig, table, source)
