"""Drive profiles: what a CiA 402 drive does its own way, as TOML beside its EDS.

A profile says which objects go into which PDO, what a digit is worth, how the period is told, how
the drive stops and what it watches. The EDS says which objects there are and how long they are;
what a profile calls optional and an EDS lacks is left out. A new drive needs both files, no code:
`[drive] profile = "my-drive.toml"`. Shipped ones are named without their ending.

Two names stand for objects that depend on the rig: `load_position` is the drive's second encoder
(0x60E4:n) where the rig's load angle comes from there, `current` is `[units.current]`'s object.
"""

from functools import cache
from typing import Annotated, Literal, TypeAlias

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    WithJsonSchema,
    model_validator,
)

from drivers.profile_file import PROFILES, read_profile, shipped_names

SHIPPED = PROFILES / "canopen"
GENERIC = "generic"

Address: TypeAlias = tuple[int, int]
"""Index and sub-index of an object."""

CONTROLWORD, STATUSWORD, POSITION, TARGET_VELOCITY = (
    (0x6040, 0),
    (0x6041, 0),
    (0x6064, 0),
    (0x60FF, 0),
)
VELOCITY, TORQUE, TIME_STAMP = (0x606C, 0), (0x6077, 0), (0x1013, 0)
LOAD_POSITION, CURRENT = "load_position", "current"


def _address(text: object) -> Address:
    """`"0x60E4:2"` as (0x60E4, 2)."""
    if not isinstance(text, str):
        raise ValueError(f'{text!r} is no object: write "0x60E4" or "0x60E4:2"')
    index, _, sub = text.partition(":")
    address = int(index, 16), int(sub or "0")
    if not (0x1000 <= address[0] <= 0xFFFF and 0 <= address[1] <= 0xFF):
        raise ValueError(f"{text!r}: an index is 0x1000 to 0xFFFF, a sub-index 0 to 255")
    return address


def _slot(text: object) -> Address | str:
    return str(text) if text in (LOAD_POSITION, CURRENT) else _address(text)


_WRITTEN = WithJsonSchema({"type": "string", "format": "object"})
Object = Annotated[Address, BeforeValidator(_address), _WRITTEN]
PdoObject = Annotated[Address | str, BeforeValidator(_slot), _WRITTEN]
PdoNumber = Annotated[int, Field(ge=1, le=16)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class CommandPdo(_Table):
    """`[command]`: the RPDO that carries controlword and target velocity."""

    pdo: PdoNumber = 1
    """Number of the RPDO."""
    objects: tuple[Object, ...] = (CONTROLWORD, TARGET_VELOCITY)
    """What it holds: always controlword and target velocity."""

    @model_validator(mode="after")
    def _complete(self) -> "CommandPdo":
        if self.objects != (CONTROLWORD, TARGET_VELOCITY):
            raise ValueError("the command PDO holds 0x6040 and 0x60FF, in this order")
        return self


class AnswerPdo(_Table):
    """`[[answers]]`: one TPDO."""

    pdo: PdoNumber
    """Number of the TPDO."""
    objects: tuple[Object, ...] = ()
    """Objects that it always holds."""
    optional: tuple[PdoObject, ...] = ()
    """Objects that it holds where EDS and rig have them; also `load_position`, `current`."""
    needs: PdoObject | None = None
    """The object without which the whole PDO is left out."""


class CurrentUnit(_Table):
    """`[units.current]`: per mille of 0x6075 (mA), or `a_per_digit` where the drive counts so."""

    object: Object = (0x6078, 0)
    """Where the current is."""
    a_per_digit: float | None = Field(default=None, gt=0.0)
    """A digit's worth, A; by default per mille of 0x6075."""


class Units(_Table):
    """`[units]`: what digits are worth."""

    ratios: tuple[Object, ...] = ((0x608F, 0), (0x6091, 0), (0x6092, 0))
    """Objects whose ratio must be the rig file's, where the EDS has them."""
    velocity_si_unit: int = 0x00B50300
    """The velocity unit, as a value of 0x60A9, where the drive has no such object."""
    set_velocity_si_unit: int | None = None
    """What is written to 0x60A9 where that is finer than the drive's default."""
    rated_torque_unit_nm: float = Field(default=1e-3, gt=0.0)
    """A digit of 0x6076, N m: 1e-3 by the standard, 1e-6 in some drives."""
    current: CurrentUnit = CurrentUnit()
    """What a digit of the current is worth."""


class Timing(_Table):
    """`[timing]`: how the drive learns the period, and when it acts."""

    period_s: tuple[float, float] = (0.0005, 0.255)
    """Shortest and longest period that the drive takes, s."""
    interpolation_time: Literal["command", "sync", "none"] = "command"
    """What goes into 0x60C2: the command's period, SYNC's, or nothing."""
    interpolation_exponent: int | None = None
    """The only exponent that 0x60C2 takes; by default -3 to -6."""
    sync_period_needed: bool = False
    """Refuses a drive whose EDS has no 0x1006 to write."""
    command_is_sync: bool = False
    """Refuses a command slower than SYNC: such drives want 0x1006 and 0x60C2 equal."""
    command_delay_cycles: int = Field(default=0, ge=0, le=4)
    """0 where a command acts at the SYNC that follows it, 1 where it acts one SYNC later."""
    sync_watchdog_periods: float | None = Field(default=None, gt=1.0)
    """Periods without SYNC after which the drive faults."""
    sync_producer: bool = False
    """The drive can produce SYNC itself (bit 30 of 0x1005)."""


class Stopping(_Table):
    """`[stopping]`: how the drive stops, and what makes it stop by itself."""

    watchdog: Literal["heartbeat", "node-guarding", "rpdo-timer", "none"] = "heartbeat"
    """The master's heartbeat (0x1016), its node guarding (0x100C, 0x100D; the master then watches
    the drive by it too), the RPDO's event timer (0x1400:5), or none."""
    quick_stop_option: int | None = 2
    """Written to 0x605A where the EDS lets it; without a value the drive keeps its own."""
    connection_lost_option: int | None = 3
    """Written to 0x6007 where the EDS lets it; without a value the drive keeps its own."""


class Temperature(_Table):
    """`[temperature]`: where the drive tells its power stage's temperature, by SDO."""

    object: Object
    """Where the temperature is."""
    c_per_digit: float = Field(gt=0.0)
    """A digit's worth, °C."""


class Gain(_Table):
    """A gain of the drive's velocity loop, and what a digit of it is worth."""

    object: Object
    """Where the gain is."""
    per_digit: float = Field(gt=0.0)
    """A digit's worth, in the gain's unit."""


class Gains(_Table):
    """`[gains]`: the velocity loop's own, in A s/rad and A/rad; None where nobody has said how the
    vendor's digits convert: such a gain is fitted from a recording."""

    proportional_a_s_per_rad: Gain | None = None
    """K_P of the velocity loop, A s/rad."""
    integral_a_per_rad: Gain | None = None
    """K_I of the velocity loop, A/rad."""


class Shaping(_Table):
    """`[[shaping]]`: an object by which the drive alters what it is commanded."""

    object: Object
    """The object."""
    what: str
    """What it does to the command, in words."""
    neutral: int | None = None
    """The value with which it does nothing."""


class DriveProfile(_Table):
    """One kind of drive."""

    title: str
    """What people call the drive."""
    sources: tuple[str, ...] = ()
    """Where the values come from."""
    notes: tuple[str, ...] = ()
    """What whoever uses it must know; `servo-bench drives NAME` prints them."""
    vendor_id: int | None = None
    """What 0x1018:1 must say where the rig file names none."""
    modes: tuple[Literal["csv", "pv"], ...] = ("csv", "pv")
    """The velocity modes that the drive has."""
    mapping: Literal["writable", "fixed"] = "writable"
    """Whether PDO mappings may be written, or only compared."""
    second_encoder: Object | None = None
    """The object of the drive's other encoder where it is not 0x60E4."""
    command: CommandPdo = CommandPdo()
    """The PDO to the drive."""
    answers: tuple[AnswerPdo, ...]
    """The PDOs from the drive."""
    units: Units = Units()
    """What digits are worth."""
    timing: Timing = Timing()
    """How the drive learns the period."""
    stopping: Stopping = Stopping()
    """How the drive stops."""
    temperature: Temperature | None = None
    """Where the drive's temperature is."""
    gains: Gains = Gains()
    """Where the gains of the velocity loop are."""
    shaping: tuple[Shaping, ...] = ()
    """Objects by which the drive alters the command."""

    @model_validator(mode="after")
    def _answers_hold_what_is_needed(self) -> "DriveProfile":
        mapped = [entry for answer in self.answers for entry in answer.objects + answer.optional]
        for needed in (STATUSWORD, POSITION):
            if needed not in [entry for answer in self.answers for entry in answer.objects]:
                raise ValueError(f"no answer holds 0x{needed[0]:04X} among its objects")
        if len(set(mapped)) != len(mapped):
            raise ValueError("an object is in two answers, or twice in one")
        if len({answer.pdo for answer in self.answers}) != len(self.answers):
            raise ValueError("two answers have the same pdo number")
        return self

    @property
    def offers_load_position(self) -> bool:
        """Whether the drive can hand out a second encoder."""
        return any(LOAD_POSITION in answer.optional for answer in self.answers)


def profile_names() -> tuple[str, ...]:
    """The profiles that ship, by name."""
    return shipped_names(SHIPPED)


@cache
def load_profile(name: str) -> DriveProfile:
    """A shipped profile by its name, or the one in a TOML file.

    Raises SettingsError where there is none, or where it says what a profile cannot.
    """
    return read_profile(name, "drive profile", SHIPPED, DriveProfile.model_validate)


def generic() -> DriveProfile:
    """The profile of a drive that keeps to CiA 402."""
    return load_profile(GENERIC)
