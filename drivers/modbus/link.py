"""One transaction at a time with one drive, over TCP or RTU: what both lines have in common.

A *link* has at most one open request. `poll` hands out the answer to it and nothing else: what
belongs to an older request, to somebody else, or to nobody is counted as a stray and dropped.
`abandon` says that the open request is given up; its answer, should it still come, is then a stray
as well. How that is known differs (see `drivers.modbus.tcp` and `drivers.modbus.rtu`).
"""

import logging
import select
from dataclasses import dataclass
from typing import Protocol

from pymodbus.pdu import ExceptionResponse, ModbusPDU

from drivers.clock import Clock
from drivers.errors import DriveError, WireError
from drivers.modbus.frames import describe_exception

logging.getLogger("pymodbus.logging").addHandler(logging.NullHandler())  # our errors say it all


_ATTEMPTS = 3


@dataclass(frozen=True, slots=True)
class Reply:
    """An answer and when its last byte was read."""

    pdu: ModbusPDU
    received_ns: int


class Link(Protocol):
    """An open line to one drive. Every method raises WireError when the line is gone."""

    name: str
    strays: int
    damaged: int
    """Frames with a wrong check sum or of a form that is none."""

    def begin(self, request: ModbusPDU) -> int:
        """Send a request, the only open one; the time just before it, in ns."""
        ...

    def poll(self, until_ns: int) -> Reply | None:
        """The answer to the open request; None where it has not come by `until_ns`."""
        ...

    def abandon(self) -> None:
        """Give the open request up."""
        ...

    def close(self) -> None:
        """Let go of the line; never raises."""
        ...


def transact(
    link: Link,
    request: ModbusPDU,
    timeout_s: float,
    clock: Clock,
    what: str,
) -> ModbusPDU:
    """One transaction of the set-up, waited for; a lost one is repeated, with twice the patience.

    A drive that writes its parameters to flash, or that a busy computer plays, answers late.
    Raises WireError where no answer comes, DriveError where the drive refuses.
    """
    for attempt in range(_ATTEMPTS):
        sent_ns = link.begin(request)
        until_ns = sent_ns + round(timeout_s * 2**attempt * 1e9)
        reply = link.poll(until_ns)
        if reply is None:
            link.abandon()
            clock.sleep_until(until_ns)
        elif isinstance(reply.pdu, ExceptionResponse):
            raise DriveError(
                f"{link.name} refuses to {what}: {describe_exception(reply.pdu)}. Check the "
                "profile's address and function code, and the drive's state."
            )
        else:
            return reply.pdu
    damaged = f"; {link.damaged} damaged frames were seen" if link.damaged else ""
    raise WireError(
        f"{link.name} does not answer: asked {_ATTEMPTS} times to {what}, waited for "
        f"{timeout_s:.3g} s and then twice as long each time{damaged}. Check the drive's supply, "
        "its unit id, the cable, and on a serial line speed, parity, and stop bits."
    )


def readable(descriptor: int, until_ns: int, clock: Clock) -> bool:
    """Wait for bytes; True when there are some, False at `until_ns`."""
    wait_s = (until_ns - clock.now_ns()) * 1e-9
    ready, _, _ = select.select([descriptor], [], [], max(wait_s, 0.0))
    return bool(ready)
