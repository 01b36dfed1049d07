"""Check sums that counters put behind their frames, by their usual names.

A CRC is Rocksoft's model: width, polynomial, initial value, reflected or not, final exclusive or;
the names are those of the catalogue of parametrised CRC algorithms (reveng.sourceforge.io).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import reduce
from operator import xor
from types import MappingProxyType


@dataclass(frozen=True, slots=True)
class Crc:
    """A CRC of 8 bits or more, by table."""

    width: int
    polynomial: int
    initial: int = 0
    reflected: bool = False
    final: int = 0
    table: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "table", tuple(self._entry(byte) for byte in range(256)))

    def __call__(self, data: bytes) -> int:
        """The CRC of `data`."""
        mask = (1 << self.width) - 1
        value = self.initial
        for byte in data:
            if self.reflected:
                value = self.table[(value ^ byte) & 0xFF] ^ (value >> 8)
            else:
                value = self.table[(value >> (self.width - 8)) ^ byte] ^ ((value << 8) & mask)
        return value ^ self.final

    def _entry(self, byte: int) -> int:
        if self.reflected:
            polynomial = int(f"{self.polynomial:0{self.width}b}"[::-1], 2)
            for _ in range(8):
                byte = (byte >> 1) ^ (polynomial if byte & 1 else 0)
            return byte
        value, top = byte << (self.width - 8), 1 << (self.width - 1)
        for _ in range(8):
            value = (value << 1) ^ (self.polynomial if value & top else 0)
        return value & ((1 << self.width) - 1)


@dataclass(frozen=True, slots=True)
class Check:
    """A check sum: how many bits it has, and how it is made of the bytes before it."""

    bits: int
    of: Callable[[bytes], int]


CHECKS = MappingProxyType(
    {
        "xor8": Check(8, lambda data: reduce(xor, data, 0)),
        "sum8": Check(8, lambda data: sum(data) & 0xFF),
        "lrc8": Check(8, lambda data: -sum(data) & 0xFF),
        "crc-8/smbus": Check(8, Crc(8, 0x07)),
        "crc-8/maxim-dow": Check(8, Crc(8, 0x31, reflected=True)),
        "crc-16/modbus": Check(16, Crc(16, 0x8005, 0xFFFF, reflected=True)),
        "crc-16/ibm-3740": Check(16, Crc(16, 0x1021, 0xFFFF)),
        "crc-16/xmodem": Check(16, Crc(16, 0x1021)),
        "crc-32/iso-hdlc": Check(
            32, Crc(32, 0x04C11DB7, 0xFFFFFFFF, reflected=True, final=0xFFFFFFFF)
        ),
    }
)


def pair_parity_holds(word: int) -> bool:
    """Whether the two upper bits of 16 are the odd parity of the bits below, each for every other.

    Bit 15 watches the odd bits and bit 14 the even ones: a word is right where the exclusive or of
    all its odd bits is 1, and that of all its even bits too.
    """
    odd, even = word & 0xAAAA, word & 0x5555
    return odd.bit_count() % 2 == 1 and even.bit_count() % 2 == 1
