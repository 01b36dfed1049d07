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
}


class Bits(Table):
    """Bits of the statusword: `statusword & mask == value`."""

    mask: int = Field(ge=1, le=0xFFFFFFFF)
    value: int = Field(ge=0, le=0xFFFFFFFF)

    def hold(self, statusword: int) -> bool:
        """Whether they are so."""
        return statusword & self.mask == self.value


class Step(Table):
    """One write of digits to an item, and the statusword that must come of it, if any."""

    write: str
    value: Number
    until: Bits | None = None


class Functions(Table):
    """`[functions]`: function codes and lengths. `read_write` = 23 where the drive has it.

    `spare_read_words` are readable registers after the cycle's last read block: reading one more
    of them after a lost answer makes a stale one recognisable by its length.
    """

    read: Literal[3, 4] = 3
    write: Literal[6, 16] = 16
    read_write: Literal[23] | None = None
    words_per_read: int = Field(default=125, ge=1, le=125)
    words_per_write: int = Field(default=121, ge=1, le=123)
    spare_read_words: int = Field(default=0, ge=0, le=8)


class Timing(Table):
    """`[timing]`: what the drive takes beside the bytes.

    `turnaround_s` is its usual time from the end of a request to the begin of the answer,
    `max_response_s` the longest: after that no answer to a request may come any more.
    `silent_interval_s` is the silence that it needs before and after every message on a serial
    line where that is longer than t3.5.
    """

    turnaround_s: float = Field(default=0.001, ge=0.0)
    max_response_s: float = Field(default=0.05, gt=0.0)
    silent_interval_s: float = Field(default=0.0, ge=0.0)
    baud_rates: tuple[int, ...] = (9600, 19200, 38400, 57600, 115200)


class CycleTable(Table):
    """`[cycle]`: the registers of one period.

    `write` is one block of neighbouring items, `read` one list for each block; an item of a block
    that the rig does not need is read all the same, a block without any is left out. `values` are
    the digits of what is written beside the target velocity.
    """

    write: tuple[str, ...] = ()
    read: tuple[tuple[str, ...], ...]
    values: dict[str, Number] = Field(default_factory=dict)


class Status(Table):
    """`[status]`: what the statusword says."""

    enabled: Bits
    fault: Bits


class Watchdog(Table):
    """`[watchdog]`: the register that makes the drive stop by itself when no request comes.

    A digit is worth `unit_s`; 0 switches it off. `action` says in words what the drive does.
    """

    item: str
    unit_s: float = Field(gt=0.0)
    range_s: tuple[float, float]
    action: str


class DriveProfile(Table):
    """One kind of drive on Modbus."""

    title: str
    sources: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    transports: tuple[Literal["modbus-tcp", "modbus-rtu"], ...]
    word_order: WordOrder = "high-first"
    functions: Functions = Functions()
    timing: Timing = Timing()
    items: dict[str, Item]
    cycle: CycleTable
    status: Status | None = None
    identity: dict[str, int] = Field(default_factory=dict)
    watchdog: Watchdog | None = None
    prepare: tuple[Step, ...] = ()
    """What must be written before the statusword can be read; nothing that moves or stops."""
    set_up: tuple[Step, ...] = ()
    reset: tuple[Step, ...] = ()
    enable: tuple[Step, ...] = ()
    stop: tuple[Step, ...] = ()
    disable: tuple[Step, ...] = ()

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
        for name in (STATUS, POSITION, LOAD, TIME):
            item = self.items.get(name)
            if item is not None and item.type == "float32":
                raise ValueError(f"[items.{name}] is a whole number, not float32")
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
