"""Frames of a counter, as lists of parts in a profile: one codec for ASCII and for binary.

A part is one of

    { text = "P" }  { hex = "5A" }                       bytes that are always there
    { field = "position", digits = 8 }                   a number in ASCII, `base` 16 or 10
    { field = "position", digits = 9, sign = true }      with + or - (or a blank) before it
    { field = "position", bytes = 4, order = "big" }     a number in binary, the lowest `bits` of it
    { check = "crc-16/ibm-3740" }                        a check sum of all parts before it, `skip`
    { check = "xor8", digits = 2, skip = 1 }             bytes left out; in ASCII with `digits`

A frame has one length. Numbers are taken as they stand, without a sign of two's complement: a
count runs over its modulus in any case (`drivers.canopen.scaling.Unwrapper`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pydantic import Field, model_validator

from drivers.counter.checks import CHECKS, pair_parity_holds
from drivers.modbus.registers import Table

Name = Literal["position", "sequence", "status", "index", "index_number"]
Order = Literal["big", "little"]
PAIR_PARITY = "pair-parity"
"""No bytes of its own: two bits of the 16-bit number before it (`drivers.counter.checks`)."""


class Part(Table):
    """One part of a frame; see this module."""

    text: str | None = None
    """Characters that are always there (ASCII)."""
    hex: str | None = None
    """Bytes that are always there, in hexadecimal."""
    field: Name | None = None
    """A number of this name."""
    check: str | None = None
    """A check of the parts before it, by its name (`drivers/counter/checks.py`)."""
    digits: int | None = Field(default=None, ge=1, le=20)
    """ASCII: how many digits the number or the check sum has."""
    base: Literal[10, 16] = 16
    """ASCII: the base of the digits."""
    sign: bool = False
    """ASCII: whether a sign, or a blank, comes before the digits."""
    octets: int | None = Field(default=None, ge=1, le=8, alias="bytes")
    """Binary: how many bytes the number has."""
    order: Order = "big"
    """Binary: which byte comes first."""
    bits: int | None = Field(default=None, ge=1, le=64)
    """Binary: only so many of the lowest bits count; by default all."""
    skip: int = Field(default=0, ge=0, le=16)
    """How many bytes at the frame's beginning the check sum leaves out."""

    @model_validator(mode="after")
    def _is_one_thing(self) -> "Part":
        given = [name for name in ("text", "hex", "field", "check") if getattr(self, name)]
        if len(given) != 1:
            raise ValueError("a part is one of text, hex, field, check")
        if self.field and (self.digits is None) == (self.octets is None):
            raise ValueError(f"field {self.field!r} takes digits (ASCII) or bytes (binary)")
        if self.hex is not None:
            bytes_of_hex(self.hex)
        if self.text is not None and not self.text.isascii():
            raise ValueError(f"text {self.text!r} is not ASCII: write it as hex")
        if self.check and self.check != PAIR_PARITY and self.check not in CHECKS:
            known = ", ".join((*CHECKS, PAIR_PARITY))
            raise ValueError(f"check {self.check!r} is not known: one of {known}")
        return self

    @property
    def literal(self) -> bytes:
        """The bytes of text or hex; empty for others."""
        if self.text is not None:
            return self.text.encode("ascii")
        return bytes_of_hex(self.hex) if self.hex is not None else b""

    @property
    def size(self) -> int:
        """How many bytes it takes."""
        if self.check == PAIR_PARITY:
            return 0
        if self.check:
            return self.digits or CHECKS[self.check].bits // 8
        if self.field:
            return (self.digits or 0) + self.sign if self.digits else self.octets or 0
        return len(self.literal)


def bytes_of_hex(text: str) -> bytes:
    """What "5A 0D" means; ValueError where it means nothing."""
    try:
        return bytes.fromhex(text)
    except ValueError as error:
        raise ValueError(f"hex {text!r}: {error}") from error


@dataclass(frozen=True, slots=True)
class Frame:
    """A codec for frames of these parts."""

    parts: tuple[Part, ...]

    @property
    def size(self) -> int:
        """The length of every frame in bytes."""
        return sum(part.size for part in self.parts)

    @property
    def fields(self) -> frozenset[str]:
        """The numbers in it."""
        return frozenset(part.field for part in self.parts if part.field)

    @property
    def is_checked(self) -> bool:
        """Whether a wrong bit can be seen at all."""
        return any(part.check for part in self.parts)

    def modulus(self, name: Name) -> int:
        """Where a number runs over; 0 where there is none of that name."""
        for part in self.parts:
            if part.field == name:
                if part.bits is not None:
                    return 1 << part.bits
                if part.digits is not None:
                    return int(part.base**part.digits) * (2 if part.sign else 1)
                return 1 << 8 * (part.octets or 0)
        return 0

    def encode(self, values: Mapping[str, int]) -> bytes:
        """A frame with these numbers; ValueError where one does not fit."""
        data = b""
        for part in self.parts:
            if part.check == PAIR_PARITY:
                raise ValueError(f"{PAIR_PARITY} is read, never sent")
            if part.check:
                data += _written(part, CHECKS[part.check].of(data[part.skip :]))
            elif part.field:
                data += _written(part, values[part.field])
            else:
                data += part.literal
        return data

    def decode(self, data: bytes) -> dict[str, int] | None:
        """The numbers of a whole frame; None where its bytes or its check sum are wrong."""
        found: dict[str, int] = {}
        if len(data) != self.size:
            return None
        at = 0
        for part in self.parts:
            piece = data[at : at + part.size]
            if part.check == PAIR_PARITY:
                good = at >= 2 and _pair_parity(data[at - 2 : at], self.parts)
            elif part.check:
                good = piece == _written(part, CHECKS[part.check].of(data[part.skip : at]))
            elif part.field:
                value = _read(part, piece)
                good = value is not None
                found[part.field] = value or 0
            else:
                good = piece == part.literal
            if not good:
                return None
            at += part.size
        return found


def _pair_parity(word: bytes, parts: tuple[Part, ...]) -> bool:
    order = next(part.order for part in parts if part.field)
    return pair_parity_holds(int.from_bytes(word, order))


def _written(part: Part, value: int) -> bytes:
    """A number as the part has it."""
    if part.digits is None:
        size = part.size
        try:
            return value.to_bytes(size, part.order)
        except OverflowError as error:
            raise ValueError(f"{value} does not fit into {size} bytes") from error
    sign = ("-" if value < 0 else "+") if part.sign else ""
    digits = f"{abs(value):0{part.digits}{'X' if part.base == 16 else 'd'}}"
    if len(digits) > part.digits or (value < 0 and not part.sign):
        raise ValueError(f"{value} does not fit into {part.digits} digits")
    return f"{sign}{digits}".encode("ascii")


def _read(part: Part, piece: bytes) -> int | None:
    """The number; None where its characters are no digits."""
    if part.digits is None:
        value = int.from_bytes(piece, part.order)
        return value if part.bits is None else value & ((1 << part.bits) - 1)
    text = piece.decode("latin-1")
    negative = part.sign and text[0] == "-"
    if part.sign and text[0] not in "+- ":
        return None
    digits = text[part.sign :].replace(" ", "0") if part.sign else text
    allowed = "0123456789ABCDEFabcdef" if part.base == 16 else "0123456789"
    if any(digit not in allowed for digit in digits):
        return None
    value = int(digits, part.base)
    return -value if negative else value
