"""One quantity in a drive's registers: where it is, how wide, what a digit is worth.

A 32-bit quantity is two registers. Which of them comes first is the drive's own business
(`word_order`); inside a register the high byte always comes first on the wire.
"""

import math
from collections.abc import Sequence
from typing import Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field
from pymodbus.client.mixin import ModbusClientMixin

Number: TypeAlias = int | float
Type: TypeAlias = Literal["int16", "uint16", "int32", "uint32", "float32"]
WordOrder: TypeAlias = Literal["high-first", "low-first"]
Unit: TypeAlias = Literal[
    "", "count", "count/s", "rpm", "rad/s", "N m", "A", "per mille rated", "us", "s", "degC"
]

Address = Field(ge=0, le=0xFFFF)

_CODEC = {
    "int16": ModbusClientMixin.DATATYPE.INT16,
    "uint16": ModbusClientMixin.DATATYPE.UINT16,
    "int32": ModbusClientMixin.DATATYPE.INT32,
    "uint32": ModbusClientMixin.DATATYPE.UINT32,
    "float32": ModbusClientMixin.DATATYPE.FLOAT32,
}
_RANGES = {
    "int16": (-(1 << 15), (1 << 15) - 1),
    "uint16": (0, (1 << 16) - 1),
    "int32": (-(1 << 31), (1 << 31) - 1),
    "uint32": (0, (1 << 32) - 1),
}
_FLOAT32_MAX = 3.4028234e38
_ORDER: dict[WordOrder, Literal["big", "little"]] = {"high-first": "big", "low-first": "little"}


class Table(BaseModel):
    """A table of a profile: frozen, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Item(Table):
    """`[items.NAME]`: one quantity. A digit is worth `scale` of `unit`."""

    address: int = Address
    """Address of the first register, as it goes over the wire (from 0)."""
    type: Type = "uint16"
    """How its registers are read; 32-bit types are two registers."""
    word_order: WordOrder | None = None
    """Which of two registers comes first; by default the profile's."""
    unit: Unit = ""
    """Unit of the quantity."""
    scale: float = Field(default=1.0, gt=0.0)
    """A digit's worth, in `unit`."""
    read: Literal[3, 4] | None = None
    """Function code that reads it (3 holding, 4 input registers); by default the profile's."""
    write: Literal[6, 16] | None = None
    """Function code that writes it (6 one register, 16 several); by default the profile's."""

    @property
    def words(self) -> int:
        """How many registers it takes."""
        return 1 if self.type in ("int16", "uint16") else 2

    @property
    def end(self) -> int:
        """The address after its last register."""
        return self.address + self.words

    @property
    def modulus(self) -> int:
        """How many values it has before it wraps."""
        return 1 << (16 * self.words)


class Codec:
    """An item's digits to registers and back, with the word order settled."""

    __slots__ = ("_order", "_type", "item")

    def __init__(self, item: Item, word_order: WordOrder) -> None:
        self.item = item
        self._type = _CODEC[item.type]
        self._order = _ORDER[item.word_order or word_order]

    def encode(self, digits: Number) -> list[int]:
        """The registers of a value in digits. ValueError where it does not fit or is no number."""
        if not math.isfinite(digits):
            raise ValueError(f"{digits} is no number a register can hold")
        if self.item.type == "float32":
            if abs(digits) > _FLOAT32_MAX:
                raise ValueError(f"{digits} is beyond float32")
            value: Number = float(digits)
        else:
            value = round(digits)
            low, high = _RANGES[self.item.type]
            if not low <= value <= high:
                raise ValueError(f"{value} digits are outside {low} to {high} ({self.item.type})")
        words: list[int] = ModbusClientMixin.convert_to_registers(
            value, self._type, word_order=self._order
        )
        return words

    def decode(self, words: Sequence[int]) -> Number:
        """The value in digits, from as many registers as the item has words."""
        value = ModbusClientMixin.convert_from_registers(
            list(words), self._type, word_order=self._order
        )
        assert isinstance(value, int | float)  # noqa: S101 - none of the types is a list or a text
        return value
