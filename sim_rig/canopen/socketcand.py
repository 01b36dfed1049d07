"""The text protocol of socketcand's raw mode, as python-can's client speaks it.

    hub     < hi >
    client  < open can0 >                       hub  < ok >
    client  < rawmode >                         hub  < ok >
    client  < send 201 6 f 0 0 10 0 0 >         identifier hex, length, bytes hex
    hub     < frame 181 1700000000.000123 270600 >

A standard identifier has three digits, an extended one eight. What cannot be understood is
answered by `< error text >`. Remote frames and error frames do not exist in it.
"""

import re
from dataclasses import dataclass

LONGEST_MESSAGE = 256
HI = b"< hi >"
OK = b"< ok >"

_CHANNEL = re.compile(r"[A-Za-z0-9_.-]{1,32}")
_HEX_DIGITS = frozenset("0123456789abcdefABCDEF")
_SEND_WORDS = 3


class ProtocolError(ValueError):
    """A message that the protocol does not know; its text is what the client is told."""


@dataclass(frozen=True, slots=True)
class Open:
    """`< open can0 >`: join the bus of that name."""

    channel: str


@dataclass(frozen=True, slots=True)
class RawMode:
    """`< rawmode >`: give me every frame."""


@dataclass(frozen=True, slots=True)
class Echo:
    """`< echo >`: are you there?"""


@dataclass(frozen=True, slots=True)
class Send:
    """`< send ID LENGTH b b ... >`: put a frame on the bus."""

    can_id: int
    extended: bool
    data: bytes


Message = Open | RawMode | Echo | Send


def take_messages(buffer: bytearray) -> list[bytes]:
    """Remove and return the whole messages at the head of `buffer`, each up to its ">".

    The cut depends on the bytes alone, not on how they were split on their way: a message ends
    at ">" or, malformed, after LONGEST_MESSAGE bytes without one.
    """
    messages: list[bytes] = []
    while True:
        end = buffer.find(b">", 0, LONGEST_MESSAGE) + 1
        if end == 0:
            if len(buffer) < LONGEST_MESSAGE:
                return messages
            end = LONGEST_MESSAGE
        messages.append(bytes(buffer[:end]))
        del buffer[:end]


def parse(message: bytes) -> Message:
    """What a client says. Raises ProtocolError with the reason."""
    try:
        text = message.decode("ascii").strip()
    except UnicodeDecodeError:
        raise ProtocolError("bytes outside ASCII") from None
    if not (text.startswith("<") and text.endswith(">")) or "<" in text[1:]:
        raise ProtocolError("a message is words between angle brackets")
    words = text[1:-1].split()
    match words:
        case ["send", *_]:
            return _parse_send(words)
        case ["open", channel] if _CHANNEL.fullmatch(channel):
            return Open(channel)
        case ["rawmode"]:
            return RawMode()
        case ["echo"]:
            return Echo()
    raise ProtocolError("unknown command, this hub knows open, rawmode, send, echo")


def _hex(word: str) -> int:
    if not _HEX_DIGITS.issuperset(word):
        raise ProtocolError("send wants hexadecimal numbers")
    return int(word, 16)


def _parse_send(words: list[str]) -> Send:
    if len(words) < _SEND_WORDS:
        raise ProtocolError("send wants an identifier and a length")
    identifier, length, *values = words[1:]
    can_id, extended = _hex(identifier), len(identifier) == 8
    if len(identifier) not in (3, 8) or can_id > (0x1FFFFFFF if extended else 0x7FF):
        raise ProtocolError("an identifier is 3 digits up to 7FF or 8 digits up to 1FFFFFFF")
    size = _hex(length)
    if size > 8 or size != len(values):
        raise ProtocolError("length must be 0 to 8 and the number of bytes that follow")
    data = [_hex(value) for value in values]
    if any(value > 0xFF for value in data):
        raise ProtocolError("a byte is 0 to ff")
    return Send(can_id, extended, bytes(data))


def frame_message(frame: Send, time_us: int) -> bytes:
    """`< frame ... >` for a frame that the bus carried at `time_us`.

    Without data the two blanks before ">" stay: python-can's client counts the words.
    """
    width = 8 if frame.extended else 3
    seconds, microseconds = divmod(time_us, 1_000_000)
    return b"< frame %0*X %d.%06d %s >" % (
        width,
        frame.can_id,
        seconds,
        microseconds,
        frame.data.hex().upper().encode(),
    )


def error_message(text: str) -> bytes:
    """`< error ... >`; `text` must be ASCII without angle brackets."""
    return b"< error %s >" % text.encode("ascii")
