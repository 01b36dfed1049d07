"""A counter at the far end of a socket, scripted answer by answer, for tests of the master alone.

It lives in the master's own thread, on a time that moves by looks alone: whenever the master looks
at its clock the peer answers what has come. A machine that stalls makes nothing late.
"""

import binascii
import select
import socket
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

import pytest

from drivers.clock import Clock
from drivers.counter import counter

Act = Callable[[int, bytes], list[bytes]]
"""Number of the request and its bytes -> what is sent, piece by piece."""
LOOK_NS = 200_000


def binary_answer(
    sequence: int, position: int, *, status: int = 0, number: int = 0, index: int = 0
) -> bytes:
    """The generic binary frame by hand, its CRC by the standard library."""
    body = bytes((0x5A, sequence, status, number))
    body += (position % (1 << 32)).to_bytes(4, "little") + (index % (1 << 32)).to_bytes(4, "little")
    return body + binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "little")


class Peer:
    """Answers while it is entered, which puts it in the place of every serial device."""

    def __init__(self, act: Act, request_bytes: int) -> None:
        self._act = act
        self._request_bytes = request_bytes
        self._near, self._far = socket.socketpair()
        self._received = b""
        self._patch = pytest.MonkeyPatch()
        self.requests: list[bytes] = []
        self.now_ns = 1_000_000_000

    def __enter__(self) -> Self:
        self._patch.setattr(counter, "open_port", self._open)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._patch.undo()
        self._near.close()
        self._far.close()

    def clock(self) -> Clock:
        """The master's clock."""
        return Clock(self._look, self._sleep)

    @property
    def is_let_go(self) -> bool:
        """Whether the master has closed the line."""
        return self._far.fileno() == -1

    def unplug(self) -> None:
        """Hang up, for good."""
        self._near.close()

    def _open(self, *_: Any, **__: Any) -> socket.socket:
        self._far.setblocking(False)
        return self._far  # of a serial port the master takes fileno and close alone

    def _look(self) -> int:
        self.now_ns += LOOK_NS
        self._answer()
        return self.now_ns

    def _sleep(self, seconds: float) -> None:
        self.now_ns += round(max(seconds, 0.0) * 1e9)

    def _answer(self) -> None:
        while self._near.fileno() != -1 and select.select([self._near], [], [], 0)[0]:
            data = self._near.recv(4096)
            if not data:
                return
            self._received += data
            size = self._request_bytes
            while len(self._received) >= size:
                request, self._received = self._received[:size], self._received[size:]
                self.requests.append(request)
                for piece in self._act(len(self.requests) - 1, request):
                    self._near.send(piece)
