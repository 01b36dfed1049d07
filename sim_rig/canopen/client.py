"""What a rig asks of python-can's socketcand client besides `send` and `recv`.

The client keeps its socket private, and its interface has no word for either of these. On every
other interface they ask nothing.
"""

import select
import socket
from types import TracebackType
from typing import Self

import can

_CORK: int = getattr(socket, "TCP_CORK", 0)  # Linux


def _socket_of(bus: can.BusABC) -> socket.socket | None:
    sock: socket.socket | None = getattr(bus, "_SocketCanDaemonBus__socket", None)
    return sock


def hung_up(bus: can.BusABC) -> bool:
    """Whether the hub behind a socketcand bus has closed the connection.

    python-can's client reads end-of-file as "nothing yet", for ever.
    """
    sock = _socket_of(bus)
    if sock is None:
        return False
    try:
        readable, _, _ = select.select([sock], [], [], 0)
        return bool(readable) and not sock.recv(1, socket.MSG_PEEK)
    except OSError:
        return True


class Outgoing:
    """Frames on their way to a bus; those of one `with` reach a hub in one piece.

    What a SYNC brings about are three frames. Each alone would wake the hub, and the hub everyone
    else, three times in a tenth of a millisecond: most of what a period costs a small machine.
    Outside of `with`, and on a bus without a hub, each frame leaves at once.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._sock = _socket_of(bus) if _CORK else None
        self._within = self._held = False

    def send(self, can_id: int, data: bytes) -> None:
        """One frame. Raises what `can.Bus.send` raises, and OSError where the hub is gone."""
        if self._within and not self._held:
            self._hold(held=True)
        self._bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def _hold(self, *, held: bool) -> None:
        if self._sock is not None:
            self._sock.setsockopt(socket.IPPROTO_TCP, _CORK, held)
            self._held = held

    def __enter__(self) -> Self:
        self._within = True
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._within = False
        if self._held:
            self._hold(held=False)
