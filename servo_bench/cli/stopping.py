"""Ctrl-C, SIGTERM, and a terminal that hangs up as a question to ask, not as an exception."""

import getpass
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

WORDS = {
    signal.SIGINT: "Ctrl-C",
    signal.SIGTERM: "SIGTERM",
    signal.SIGHUP: "the end of the terminal",
}


class StopAsked:
    """Whether a signal has come: ask it like a function. `by` says for the record who it was."""

    def __init__(self) -> None:
        self._first: signal.Signals | None = None

    def __call__(self) -> bool:
        return self._first is not None

    @property
    def by(self) -> str:
        """The user whose program this is and the first signal; "" before one."""
        return "" if self._first is None else f"{user()} ({WORDS[self._first]})"

    def note(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002
        """A signal's handler."""
        self._first = self._first or signal.Signals(number)


@contextmanager
def asked_to_stop() -> Iterator[StopAsked]:
    """Yield what says whether SIGINT, SIGTERM, or SIGHUP has come.

    A SIGHUP that is ignored already (nohup) stays so. The handlers are put back.
    """
    asked = StopAsked()
    heeded = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        heeded.append(signal.SIGHUP)
    before = {number: signal.signal(number, asked.note) for number in heeded}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def user() -> str:
    """Whose program this is; a user id need not have a name, as in some containers."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "the operator"
