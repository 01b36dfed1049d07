"""Drive profiles: what a drive on Modbus has in which register, as one TOML file.

A profile says where each quantity is and what a digit is worth (`[items]`), what goes over the
wire in a period (`[cycle]`), how the drive is enabled, stopped, and reset (`[[enable]]` and so
on, each step one register write and what must come of it), how quick the drive is (`[timing]`),
and what makes it stop by itself (`[watchdog]`). A new drive needs such a file and no code:
`[drive] profile = "my-drive.toml"`. Shipped ones are named without their ending.

Items whose names mean something to the bench:

    target_velocity                      written in every period
    statusword, motor_position           read in every period
    motor_velocity, motor_torque, motor_current, load_position, device_time     read where there
    drive_temperature                    read in every period where it has a limit
    error_code                           told when the drive faults
    rated_torque, rated_current          read once, for per-mille units
    motor_counts_per_revolution, load_counts_per_revolution     read once and compared
"""

from typing import Literal

from pydantic import Field, model_validator

from drivers.modbus.registers import Codec, Item, Number, Table, WordOrder

TARGET, STATUS, POSITION, LOAD = (
    "target_velocity",
    "statusword",
    "motor_position",
    "load_position",
)
VELOCITY, TORQUE, CURRENT, TIME = "motor_velocity", "motor_torque", "motor_current", "device_time"
TEMPERATURE = "drive_temperature"
RATED_TORQUE, RATED_CURRENT, ERROR_CODE = "rated_torque", "rated_current", "error_code"
MOTOR_COUNTS, LOAD_COUNTS = "motor_counts_per_revolution", "load_counts_per_revolution"

_UNITS: dict[str, tuple[str, ...]] = {
    TARGET: ("count/s", "rpm", "rad/s"),
    VELOCITY: ("count/s", "rpm", "rad/s"),
    POSITION: ("count",),
    LOAD: ("count",),
    TORQUE: ("N m", "per mille rated"),
    CURRENT: ("A", "per mille rated"),
    RATED_TORQUE: ("N m",),
    RATED_CURRENT: ("A",),
    TIME: ("us",),
    TEMPERATURE: ("degC",),
}
_WHOLE = ("int16", "uint16", "int32", "uint32")
_TYPES: dict[str, tuple[str, ...]] = {
    STATUS: ("uint16", "uint32"),
    POSITION: _WHOLE,
    LOAD: _WHOLE,
    TIME: ("uint32",),
}
_WHY = {
    STATUS: "Its bits are no number that can be negative.",
    POSITION: "It is a whole number of counts.",
    LOAD: "It is a whole number of counts.",
    TIME: "Differences are taken where 32 bits begin again.",
}
_UNSCALED = {
    STATUS: "",
    POSITION: ", and put it into drive.counts_per_revolution",
    LOAD: ", and put it into drive.second_encoder.counts_per_revolution",
}


class Bits(Table):
    """Bits of the statusword: `statusword & mask == value`."""

    mask: int = Field(ge=1, le=0xFFFFFFFF)
    """Which bits count."""
    value: int = Field(ge=0, le=0xFFFFFFFF)
    """What they must be."""

    def hold(self, statusword: int) -> bool:
        """Whether they are so."""
        return statusword & self.mask == self.value


class Step(Table):
    """One write of digits to an item, and the statusword that must come of it, if any."""

    write: str
    """The item that is written."""
    value: Number
    """The digits that are written."""
    until: Bits | None = None
    """What the statusword must then become; by default it is not asked."""


class Functions(Table):
    """`[functions]`: function codes and lengths."""

    read: Literal[3, 4] = 3
    """Function code that reads."""
    write: Literal[6, 16] = 16
    """Function code that writes."""
    read_write: Literal[23] | None = None
    """Function code that does both at once, where the drive has it."""
    words_per_read: int = Field(default=125, ge=1, le=125)
    """Most registers of one read."""
    words_per_write: int = Field(default=121, ge=1, le=123)
    """Most registers of one write."""
    spare_read_words: int = Field(default=0, ge=0, le=8)
    """Readable registers after the last read block: after a lost answer one more is read, so that a
    late one shows by its length."""


class Timing(Table):
    """`[timing]`: what the drive takes beside the bytes."""

    turnaround_s: float = Field(default=0.001, ge=0.0)
    """Usual time from the end of a request to the begin of the answer, s."""
    max_response_s: float = Field(default=0.05, gt=0.0)
    """Longest such time, s: after it no answer may come any more."""
    silent_interval_s: float = Field(default=0.0, ge=0.0)
    """Silence around every message on a serial line, s, where longer than t3.5."""
    baud_rates: tuple[int, ...] = (9600, 19200, 38400, 57600, 115200)
    """Speeds that the drive can be set to, Bd."""


class CycleTable(Table):
    """`[cycle]`: the registers of one period, in blocks of neighbouring items.

    An item of a block that the rig does not need is read all the same; a block without any that
    it needs is left out.
    """

    write: tuple[str, ...] = ()
    """Items of the one block that is written in every period."""
    read: tuple[tuple[str, ...], ...]
    """Items of each block that is read in every period."""
    values: dict[str, Number] = Field(default_factory=dict)
    """Digits of what is written beside the target velocity, by item."""


class Status(Table):
    """`[status]`: what the statusword says."""

    enabled: Bits
    """The bits of a drive that is enabled."""
    fault: Bits
    """The bits of a drive that has a fault."""


class Watchdog(Table):
    """`[watchdog]`: the register that makes the drive stop by itself when no request comes."""

    item: str
    """The item that arms it; 0 switches it off."""
    unit_s: float = Field(gt=0.0)
    """A digit's worth, s."""
    range_s: tuple[float, float]
    """Shortest and longest time that it takes, s."""
    action: str
    """What the drive then does, in words."""


class DriveProfile(Table):
    """One kind of drive on Modbus."""

    title: str
    """What people call the drive."""
    sources: tuple[str, ...] = ()
    """Where the values come from."""
    notes: tuple[str, ...] = ()
    """What whoever uses it must know; `servo-bench drives --modbus NAME` prints them."""
    transports: tuple[Literal["modbus-tcp", "modbus-rtu"], ...]
    """Which Modbus the drive speaks."""
    word_order: WordOrder = "high-first"
    """Which register of a 32-bit quantity comes first."""
    functions: Functions = Functions()
    """Function codes and lengths."""
    timing: Timing = Timing()
    """What the drive takes beside the bytes."""
    items: dict[str, Item]
    """The quantities, by name; `drivers/modbus/profile.py` says which names the bench knows."""
    cycle: CycleTable
    """The registers of one period."""
    status: Status | None = None
    """What the statusword says; needed for a drive that is commanded."""
    identity: dict[str, int] = Field(default_factory=dict)
    """Digits that items must have for it to be this drive, by item."""
    watchdog: Watchdog | None = None
    """What makes the drive stop by itself."""
    prepare: tuple[Step, ...] = ()
    """What must be written before the statusword can be read; nothing that moves or stops."""
    set_up: tuple[Step, ...] = ()
    """Steps before a fault is reset and the drive enabled."""
    reset: tuple[Step, ...] = ()
    """Steps that reset a fault."""
    enable: tuple[Step, ...] = ()
    """Steps that enable the drive."""
    stop: tuple[Step, ...] = ()
    """Steps that stop it, after velocity 0."""
    disable: tuple[Step, ...] = ()
    """Steps that switch it off."""

    @model_validator(mode="after")
    def _names_are_known(self) -> "DriveProfile":
        read = [name for block in self.cycle.read for name in block]
        used = [*self.cycle.write, *read, *self.identity, *(step.write for step in self.steps)]
        used += [self.watchdog.item] if self.watchdog else []
        missing = sorted(set(used) - set(self.items))
        if missing:
            raise ValueError(f"no [items.{missing[0]}]: every name that is used needs one")
        for needed in (STATUS, POSITION):
            if needed not in read:
                raise ValueError(f"[cycle] read lacks {needed}")
        if self.cycle.write and self.status is None:
            raise ValueError("a drive that is commanded needs [status]")
        if self.cycle.write and TARGET not in self.cycle.write:
            raise ValueError(f"[cycle] write lacks {TARGET}")
        unset = set(self.cycle.write) - {TARGET} - set(self.cycle.values)
        if unset:
            raise ValueError(f"[cycle] values lacks {min(unset)}, which is written every period")
        if len(set(read)) != len(read):
            raise ValueError("[cycle] read names an item twice")
        return self

    @model_validator(mode="after")
    def _units_are_known(self) -> "DriveProfile":
        for name, allowed in _UNITS.items():
            item = self.items.get(name)
            if item is not None and item.unit not in allowed:
                raise ValueError(f"[items.{name}] unit = {item.unit!r}: one of {allowed}")
        return self

    @model_validator(mode="after")
    def _digits_can_be_used(self) -> "DriveProfile":
        for name, types in _TYPES.items():
            item = self.items.get(name)
            if item is not None and item.type not in types:
                raise ValueError(
                    f'[items.{name}] type = "{item.type}": one of {", ".join(types)}. '
                    f"{_WHY[name]} Correct the type, or leave the item out where the drive has none"
                )
        for name, setting in _UNSCALED.items():
            item = self.items.get(name)
            if item is not None and item.scale != 1.0:
                raise ValueError(
                    f"[items.{name}] scale = {item.scale:g}: its digits are taken as they are, 1 "
                    f"is allowed. Leave scale out{setting}"
                )
        time = self.items.get(TIME)
        if time is not None and not time.scale.is_integer():
            raise ValueError(
                f"[items.{TIME}] scale = {time.scale:g}: whole microseconds are allowed, or the "
                "clock would not begin again at a multiple of 2^32 us. Leave the item out"
            )
        return self

    @model_validator(mode="after")
    def _steps_fit(self) -> "DriveProfile":
        for step in self.steps:
            self.codec(step.write).encode(step.value)
        for name, digits in self.cycle.values.items():
            self.codec(name).encode(digits)
        return self

    @property
    def steps(self) -> tuple[Step, ...]:
        """Every step of every sequence."""
        first = (*self.prepare, *self.set_up, *self.reset)
        return (*first, *self.enable, *self.stop, *self.disable)

    @property
    def bits(self) -> Status:
        """What the statusword of a drive that is commanded says."""
        assert self.status is not None  # noqa: S101 - no profile with [cycle] write lacks it
        return self.status

    @property
    def is_commanded(self) -> bool:
        """Whether the drive takes a velocity over Modbus at all."""
        return bool(self.cycle.write)

    def codec(self, name: str) -> Codec:
        """An item's codec; ValueError where there is no such item."""
        if name not in self.items:
            raise ValueError(f"no [items.{name}]")
        return Codec(self.items[name], self.word_order)
