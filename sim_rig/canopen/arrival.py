"""When bytes came to a TCP socket by the kernel's clock, however late they are read.

A real interface stamps a frame as it comes off the wire. A hub that stamps what it has read stamps
its own turn on the processor: where the machine is shared, milliseconds later, and a rig that takes
the stamp for the time of a SYNC samples that much too late. Linux notes the time at which a segment
came (SO_TIMESTAMPNS; socket(7), and for TCP since 4.15); of bytes read together it tells the last
segment's. Elsewhere, and where a clock was set in between, reading is the arrival.
"""

import socket
import struct
import time

# Linux's own number and layout (asm-generic/socket.h), which Python's socket module does not name.
_SO_TIMESTAMPNS = 35
_TIMESPEC = struct.Struct("@qq")
_ANCILLARY_BYTES = 64
_SECOND_NS = 1_000_000_000
OLDEST_NS = 10 * _SECOND_NS
"""Nobody leaves a bus unread for so long: a stamp of before is of a clock that was set."""


def note_arrivals(sock: socket.socket) -> None:
    """Have the kernel tell with what is read when it came, where it can."""
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    except OSError:
        return


def receive(sock: socket.socket, size: int) -> tuple[bytes, int]:
    """What came, up to `size` bytes, and for how long it lay unread in ns: 0 where nobody knows.

    Raises what `socket.recv` raises.
    """
    chunk, told, _, _ = sock.recvmsg(size, _ANCILLARY_BYTES)
    for level, kind, value in told:
        if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS) and len(value) >= _TIMESPEC.size:
            seconds, nanoseconds = _TIMESPEC.unpack_from(value)
            age_ns = time.time_ns() - seconds * _SECOND_NS - nanoseconds
            return chunk, age_ns if 0 <= age_ns <= OLDEST_NS else 0
    return chunk, 0
