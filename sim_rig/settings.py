"""What the software rig must be told; all of it values."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from sim_rig.counter import orders as counter_orders
from sim_rig.counter.settings import CounterSettings
from sim_rig.errors import RigSettingsError
from sim_rig.faults.catalogue import parse
from sim_rig.modbus import orders

BusOptions = Mapping[str, str | int | float | bool]
"""The keyword arguments of `can.Bus`: interface, channel, and what that interface wants."""

CANOPEN = "canopen"
PROTOCOLS = (CANOPEN, "modbus-tcp", "modbus-rtu")

ENCODER_DEVICE = "encoder_device"
"""Under which name the rig tells, beside its bus, where its serial counter is."""

OWN_MODEL = "model"
"""The plant that is the rig's own model."""


@dataclass(frozen=True, slots=True)
class Nominal:
    """The rig as its data sheets describe it.

    A PI velocity loop (K_P, K_I) drives an inertia J through a torque constant K_T, and the
    motor's angle reaches the load through a play of full width `backlash_gap_rad` (the paper's
    W = |2a|). From them, as in the paper's eqs. (14)-(16),

        G(s) = (2 zeta wn s + wn^2) / (s^2 + 2 zeta wn s + wn^2)
        wn   = sqrt(K_I K_T / J),      zeta = (K_P / 2) sqrt(K_T / (J K_I)).

    Raises RigSettingsError where a value has no physical meaning.
    """

    torque_constant_nm_per_a: float
    inertia_kg_m2: float
    proportional_gain_a_s_per_rad: float
    integral_gain_a_per_rad: float
    backlash_gap_rad: float = 0.0

    def __post_init__(self) -> None:
        for name in (
            "torque_constant_nm_per_a",
            "inertia_kg_m2",
            "proportional_gain_a_s_per_rad",
            "integral_gain_a_per_rad",
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise RigSettingsError(f"{name} = {value}: must be a finite number above zero.")
        if not (math.isfinite(self.backlash_gap_rad) and self.backlash_gap_rad >= 0.0):
            raise RigSettingsError(
                f"backlash_gap_rad = {self.backlash_gap_rad}: a gap is zero (none) or wider."
            )

    @property
    def natural_frequency_rad_s(self) -> float:
        """wn of eq. (15)."""
        return math.sqrt(
            self.integral_gain_a_per_rad * self.torque_constant_nm_per_a / self.inertia_kg_m2
        )

    @property
    def damping_ratio(self) -> float:
        """zeta of eq. (16)."""
        return (self.proportional_gain_a_s_per_rad / 2.0) * math.sqrt(
            self.torque_constant_nm_per_a / (self.inertia_kg_m2 * self.integral_gain_a_per_rad)
        )


@dataclass(frozen=True, slots=True)
class RigSettings:
    """The software rig on its wire.

    `plant` names what moves: "model" for the rig's own, with the `effects` that `[effects.NAME]`
    tables give it, or "package.module:factory", a callable (nominal, seed) -> Plant, for somebody
    else's. Encoder noise is white, per sample,
    before quantisation. `host_hub` starts the TCP bus hub that a socketcand bus on loopback needs.
    `rated_torque_nm` is what 0x6077 is per mille of (0x6076), `drive_temperature_c` what a drive on
    Modbus says. `faults` are lines as in
    `sim_rig.faults.catalogue`. `protocol` is the wire (faults on
    Modbus: `sim_rig.modbus.orders`): there the drive's node id is its unit
    id, the load's encoder hangs on the drive, and `bus` is host and port, or baud_rate, parity,
    stop_bits, and turnaround_s of the pty that the rig opens. `counter` is a serial counter on the
    load, on a pty of its own; faults whose kind begins with "counter-" are its. `gear_ratio` and
    the directions, 1 or -1, say how the encoders sit (see `sim_rig.mounted`).

    Raises RigSettingsError where a value makes no sense.
    """

    nominal: Nominal
    bus: BusOptions
    drive_node_id: int
    motor_counts_per_revolution: int
    encoder_node_id: int
    load_counts_per_revolution: int
    plant: str = OWN_MODEL
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    seed: int = 0
    load_encoder_noise_rad: float = 0.0
    motor_encoder_noise_rad: float = 0.0
    rated_torque_nm: float = 0.64
    drive_temperature_c: float = 35.0
    host_hub: bool = True
    faults: tuple[str, ...] = ()
    protocol: str = CANOPEN
    counter: CounterSettings | None = None
    gear_ratio: float = 1.0
    motor_direction: int = 1
    load_direction: int = 1

    @property
    def counter_faults(self) -> tuple[str, ...]:
        """The faults that are the counter's."""
        return tuple(it for it in self.faults if it.startswith(counter_orders.PREFIX))

    @property
    def wire_faults(self) -> tuple[str, ...]:
        """The faults of the drive's wire."""
        return tuple(it for it in self.faults if not it.startswith(counter_orders.PREFIX))

    def __post_init__(self) -> None:
        if self.protocol not in PROTOCOLS:
            raise RigSettingsError(
                f"protocol = {self.protocol!r}: the software rig speaks {', '.join(PROTOCOLS)}."
            )
        if self.effects and self.plant != OWN_MODEL:
            raise RigSettingsError(
                f"effects are given for plant = {self.plant!r}: only {OWN_MODEL!r} has them."
            )
        self._check_faults()
        nodes = (self.drive_node_id, self.encoder_node_id)
        if not all(1 <= node <= 127 for node in nodes) or nodes[0] == nodes[1]:
            raise RigSettingsError(
                f"drive_node_id, encoder_node_id = {nodes}: a node is 1 to 127, and each its own."
            )
        for name in ("motor_counts_per_revolution", "load_counts_per_revolution"):
            value = getattr(self, name)
            if not 1 <= value <= 2**31:
                raise RigSettingsError(f"{name} = {value}: must be 1 to 2**31.")
        if not (math.isfinite(self.gear_ratio) and self.gear_ratio > 0.0):
            raise RigSettingsError(f"gear_ratio = {self.gear_ratio}: must be above zero.")
        if not {self.motor_direction, self.load_direction} <= {1, -1}:
            raise RigSettingsError(
                f"motor_direction, load_direction = {self.motor_direction}, "
                f"{self.load_direction}: each is 1 or -1."
            )
        for name in ("load_encoder_noise_rad", "motor_encoder_noise_rad"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise RigSettingsError(f"{name} = {value}: must be finite; zero is none.")
        if not -100.0 <= self.drive_temperature_c <= 1000.0:
            raise RigSettingsError(
                f"drive_temperature_c = {self.drive_temperature_c}: must be -100 to 1000."
            )
        if not (math.isfinite(self.rated_torque_nm) and self.rated_torque_nm > 0.0):
            raise RigSettingsError(
                f"rated_torque_nm = {self.rated_torque_nm}: must be a finite number above zero."
            )

    def _check_faults(self) -> None:
        for line in self.counter_faults:
            counter_orders.parse(line)
            if self.counter is None:
                raise RigSettingsError(
                    f"fault {line!r}: this rig has no serial counter. Order it on one that has "
                    '([encoder] protocol = "serial").'
                )
        for line in self.wire_faults:
            if self.protocol == CANOPEN:
                parse(line)
            else:
                orders.parse(line)
