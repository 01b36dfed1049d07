"""A way to the drive besides the axis's own, for whoever watches the axis.

Held by another process than the one that commands. On a bus with several owners it listens from
the beginning; on a line with one owner it is opened when that owner has gone.
"""

from collections.abc import Sequence
from typing import Protocol

from drivers.axis import WireEvent


class StopLine(Protocol):
    """Listens, and stops one drive. One thread uses it."""

    def open(self) -> str:
        """Take the line where it can be shared; a sentence that says how a stop will go out.

        Raises DriverError where it cannot be opened.
        """
        ...

    def poll(self) -> Sequence[WireEvent]:
        """What the wire has said by itself since the last call; returns at once.

        Raises WireError where the line has failed.
        """
        ...

    def temperature_c(self) -> float | None:
        """The drive's temperature; None where it does not tell. Waits for 0.1 s at the most."""
        ...

    def stop(self) -> str | None:
        """Quick stop, velocity 0, power off: what is wrong, or None when the drive confirms it.

        Whoever commanded the drive must be silent by now. Never raises a DriverError.
        """
        ...

    def close(self) -> None:
        """Let go of the line."""
        ...
