"""The rig as its TOML file describes it: nominal values, bus, drive, encoder, limits, simulation.

`RigConfig` is the one place where a rig's numbers live; it hands the drivers and the software rig
their settings. Reader's units are accepted in every table (`backlash_gap_deg = 1.5`).
"""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PositiveFloat, PositiveInt

from drivers.canopen.settings import CanopenSettings, DriveSettings, EncoderSettings, NodeSettings
from servo_bench.errors import gathered
from servo_bench.files import Value, find, read_toml, validated
from sim_rig.settings import Nominal, RigSettings

NodeId = Annotated[int, Field(ge=1, le=127)]


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


class DriveConfig(NodeConfig):
    """`[drive]`: the CiA 402 drive."""

    gear_ratio: PositiveFloat = 1.0
    mode: Literal["csv", "pv"] = "csv"
    heartbeat_s: PositiveFloat = 0.1
    heartbeat_timeout_s: PositiveFloat = 0.3
    enable_timeout_s: PositiveFloat = 2.0
    stop_timeout_s: PositiveFloat = 2.0
    sdo_timeout_s: PositiveFloat = 0.5

    def settings(self) -> DriveSettings:
        """The drive for the drivers; ConfigError where its EDS cannot be found."""
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
        )


class EncoderConfig(NodeConfig):
    """`[encoder]`: the CiA 406 encoder behind the coupling."""

    def settings(self) -> EncoderSettings:
        """The encoder for the drivers; ConfigError where its EDS cannot be found."""
        return EncoderSettings(self.node_settings(), self.counts_per_revolution, self.direction)


class Limits(Value):
    """`[limits]`: checked before the drive is enabled and in every period after.

    Travel is the load's and the motor's distance from where the run began, to either side.
    """

    velocity_rad_s: PositiveFloat
    travel_rad: PositiveFloat
    run_time_s: PositiveFloat


class SimulatedConfig(Value):
    """`[simulated]`: only the software rig reads this; a real rig's file has no such table."""

    plant: str = "paper"
    seed: int = 0
    load_encoder_noise_rad: float = Field(default=0.0, ge=0.0)
    motor_encoder_noise_rad: float = Field(default=0.0, ge=0.0)
    rated_torque_nm: PositiveFloat = 0.64
    backlash_gap_rad: float | None = Field(default=None, ge=0.0)
    """The gap the software rig really has, where it differs from the nominal one."""


class RigConfig(Value):
    """One rig, whole."""

    name: str
    nominal: NominalConfig
    bus: dict[str, str | int | float | bool]
    drive: DriveConfig
    encoder: EncoderConfig | None = None
    limits: Limits
    simulated: SimulatedConfig | None = None

    def nominal_values(self) -> Nominal:
        """The nominal rig in the simulation's own words."""
        return Nominal(**self.nominal.model_dump())

    def canopen_settings(self, period_s: float) -> CanopenSettings:
        """What the CANopen master needs to run this rig at `period_s`."""
        return CanopenSettings(
            bus=self.bus,
            drive=self.drive.settings(),
            encoder=self.encoder.settings() if self.encoder else None,
            period_s=period_s,
        )

    def simulation_settings(self) -> RigSettings:
        """What the software rig needs to stand in for this rig."""
        simulated = self.simulated or SimulatedConfig()
        nominal = self.nominal.model_dump()
        if simulated.backlash_gap_rad is not None:
            nominal["backlash_gap_rad"] = simulated.backlash_gap_rad
        encoder = self.encoder
        with gathered():
            return RigSettings(
                nominal=Nominal(**nominal),
                bus=self.bus,
                drive_node_id=self.drive.node_id,
                motor_counts_per_revolution=self.drive.counts_per_revolution,
                encoder_node_id=encoder.node_id if encoder else 2,
                load_counts_per_revolution=encoder.counts_per_revolution if encoder else 65536,
                plant=simulated.plant,
                seed=simulated.seed,
                load_encoder_noise_rad=simulated.load_encoder_noise_rad,
                motor_encoder_noise_rad=simulated.motor_encoder_noise_rad,
                rated_torque_nm=simulated.rated_torque_nm,
            )

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
