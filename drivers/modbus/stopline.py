"""`drivers.stopline.StopLine` for Modbus: a connection that is opened when the master has gone.

It never asks the drive anything while a master lives: every request feeds the drive's
communication timeout, which must run out when the master dies, and many drives take one
connection only.
"""

from drivers.axis import WireEvent
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.modbus.lines import TcpLine
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.stopping import stop_anew


class ModbusStopLine:
    """See `drivers.stopline.StopLine`."""

    def __init__(self, settings: ModbusSettings, clock: Clock = SYSTEM_CLOCK) -> None:
        self._settings = settings
        self._clock = clock

    def open(self) -> str:
        """Nothing is opened yet; see `StopLine.open`."""
        own_stop_s = self._settings.own_stop_s
        by_itself = (
            "the drive does not stop by itself (drive.without_watchdog)"
            if own_stop_s is None
            else f"the drive stops by itself within {own_stop_s:g} s"
        )
        kind = "connection" if isinstance(self._settings.line, TcpLine) else "line"
        return (
            f"on a trip the bus loop is killed, and the stop goes out over a {kind} of its own; "
            f"{by_itself}."
        )

    def poll(self) -> list[WireEvent]:
        """Nothing: a Modbus drive does not speak by itself."""
        return []

    def temperature_c(self) -> float | None:
        """None: asking would feed the drive's communication timeout; the samples tell it."""
        return None

    def stop(self) -> str | None:
        """See `StopLine.stop`."""
        return stop_anew(self._settings, self._clock)

    def close(self) -> None:
        """Nothing is held."""
