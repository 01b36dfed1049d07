"""Counter profiles: how a counter box is asked and how it answers, as one TOML file.

`request` and `answer` are lists of parts (`drivers.counter.frames`). Numbers in an answer:

    position        the count; needed
    sequence        the request's number, sent back: tells a late answer from the next one
    status          bits; `[status]` says which mean that the count cannot be trusted
    index           the count that was latched at the last index pulse
    index_number    how many index pulses there were, running over

A new framing needs such a file and no code: `[encoder] profile = "my-counter.toml"`.
"""

from functools import cache
from typing import Literal

from pydantic import Field, model_validator

from drivers.counter.frames import Frame, Part
from drivers.modbus.profile import Bits
from drivers.modbus.registers import Table
from drivers.profile_file import PROFILES, read_profile, shipped_names

SHIPPED = PROFILES / "counter"
GENERIC = "generic-binary"
LONGEST_FRAME = 64
Parity = Literal["N", "E", "O"]


class LineTable(Table):
    """`[line]`: characters, and the speeds that the counter can be set to."""

    baud_rates: tuple[int, ...] = (9600, 19200, 38400, 57600, 115200)
    """Speeds that the counter can be set to, Bd."""
    data_bits: Literal[7, 8] = 8
    """Data bits of a character."""
    parity: Parity = "N"
    """Parity of a character: none, even, odd."""
    stop_bits: Literal[1, 2] = 1
    """Stop bits of a character."""


class TimingTable(Table):
    """`[timing]`: what the counter takes."""

    turnaround_s: float = Field(default=0.0005, ge=0.0)
    """Usual time from the end of a request to the begin of the answer, s."""
    max_response_s: float = Field(default=0.003, gt=0.0, le=1.0)
    """Longest such time, s: after it no answer may come any more."""
    latch_s: float = Field(default=0.0, ge=0.0)
    """Time from the end of the request to the instant of the count, s."""


class StatusTable(Table):
    """`[status]`: which bits of the status say that the count cannot be trusted, and why."""

    fault: Bits
    """The bits that say so."""
    text: str
    """Why, in words."""


class CounterProfile(Table):
    """One kind of counter on a serial line."""

    title: str
    """What people call the counter."""
    sources: tuple[str, ...] = ()
    """Where the values come from."""
    notes: tuple[str, ...] = ()
    """What whoever uses it must know; `servo-bench drives --counter NAME` prints them."""
    set_up: tuple[Part, ...] = ()
    """What is sent once, each part by itself; what is answered to it is thrown away."""
    request: tuple[Part, ...]
    """The parts of a request."""
    answer: tuple[Part, ...]
    """The parts of an answer."""
    modulus: int | None = Field(default=None, ge=2)
    """Where the count runs over, if before its digits or bytes do."""
    line: LineTable = LineTable()
    """The line's characters and speeds."""
    timing: TimingTable = TimingTable()
    """What the counter takes."""
    status: StatusTable | None = None
    """Which status bits mean that the count cannot be trusted."""

    @model_validator(mode="after")
    def _frames_are_usable(self) -> "CounterProfile":
        asked, answered = Frame(self.request).fields, Frame(self.answer).fields
        named = [part.field for part in self.answer if part.field]
        if len(set(named)) != len(named):
            raise ValueError("answer has a field twice")
        if "position" not in answered:
            raise ValueError("answer has no field position")
        if not asked <= {"sequence"}:
            raise ValueError(f"request has the field {min(asked - {'sequence'})}: only sequence")
        if ("sequence" in asked) != ("sequence" in answered):
            raise ValueError("sequence must be in the request and in the answer, or in neither")
        if ("index" in answered) != ("index_number" in answered):
            raise ValueError("index and index_number come together: a latch, and when it is new")
        if self.status is not None and "status" not in answered:
            raise ValueError("[status] needs the field status in the answer")
        if any(not part.literal for part in self.set_up):
            raise ValueError("set_up takes text and hex only")
        for name, parts in (("request", self.request), ("answer", self.answer)):
            if not 1 <= Frame(parts).size <= LONGEST_FRAME:
                raise ValueError(f"{name} takes {Frame(parts).size} bytes: 1 to {LONGEST_FRAME}")
        return self

    @property
    def asks(self) -> Frame:
        """The request's codec."""
        return Frame(self.request)

    @property
    def answers(self) -> Frame:
        """The answer's codec."""
        return Frame(self.answer)

    @property
    def is_numbered(self) -> bool:
        """Whether an answer says to which request it belongs."""
        return "sequence" in self.answers.fields

    @property
    def range(self) -> int:
        """Where the count runs over."""
        return self.modulus or self.answers.modulus("position")


def profile_names() -> tuple[str, ...]:
    """The profiles that ship, by name."""
    return shipped_names(SHIPPED)


@cache
def load_profile(name: str) -> CounterProfile:
    """A shipped profile by its name, or the one in a TOML file.

    Raises SettingsError where there is none, or where it says what a profile cannot.
    """
    return read_profile(name, "counter profile", SHIPPED, CounterProfile.model_validate)
