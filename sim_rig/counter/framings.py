"""The two framings that the software rig's counter speaks; the numbers in them are the same.

    ascii     request  P ss CR                      ss: the request's number, two hex digits
              answer   p ss tt nn pppppppp iiiiiiii xx CR LF    xx: exclusive or of all before it
    binary    request  A5 ss
              answer   5A ss tt nn pppp iiii cc     pppp, iiii, cc: low byte first
                                                    cc: CRC-16, polynomial 1021, begun with FFFF

tt is the status, nn the number of index pulses modulo 256, p the count, i the count at the last
index pulse. Bytes that are no request are passed over in silence.
"""

import binascii
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

INDEX_SEEN, FAULT = 0x01, 0x80
_MASK = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class State:
    """What a counter tells."""

    position: int
    status: int
    index_number: int
    index: int


class Framing(Protocol):
    """One way to say it; every answer takes `answer_bytes`."""

    answer_bytes: int

    def request(self, received: bytearray) -> int | None:
        """The number of a whole request at the end of what was received; None without one."""
        ...

    def answer(self, number: int, state: State) -> bytes:
        """The frame."""
        ...


class Ascii:
    """Lines of hexadecimal digits."""

    answer_bytes = 27

    def request(self, received: bytearray) -> int | None:
        """See `Framing`."""
        if len(received) < 4 or received[-4:-3] != b"P" or received[-1:] != b"\r":
            return None
        try:
            return int(received[-3:-1], 16)
        except ValueError:
            return None

    def answer(self, number: int, state: State) -> bytes:
        """See `Framing`."""
        body = (
            f"p{number:02X}{state.status:02X}{state.index_number & 0xFF:02X}"
            f"{state.position & _MASK:08X}{state.index & _MASK:08X}"
        )
        check = 0
        for character in body:
            check ^= ord(character)
        return f"{body}{check:02X}\r\n".encode("ascii")


class Binary:
    """Fourteen bytes."""

    answer_bytes = 14

    def request(self, received: bytearray) -> int | None:
        """See `Framing`."""
        return received[-1] if len(received) >= 2 and received[-2] == 0xA5 else None

    def answer(self, number: int, state: State) -> bytes:
        """See `Framing`."""
        body = bytes((0x5A, number, state.status, state.index_number & 0xFF))
        body += (state.position & _MASK).to_bytes(4, "little")
        body += (state.index & _MASK).to_bytes(4, "little")
        return body + binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "little")


FRAMINGS: MappingProxyType[str, Framing] = MappingProxyType(
    {"generic-ascii": Ascii(), "generic-binary": Binary()}
)
