"""A rig on its bus: one thread that receives, answers, and keeps the rig's deadlines."""

import threading
import time
from collections.abc import Callable
from typing import Any

import can

from sim_rig.canopen.client import Outgoing, hung_up
from sim_rig.canopen.rig import RESTING_STEP_US, Rig
from sim_rig.errors import SimRigError
from sim_rig.plant import Plant
from sim_rig.settings import BusOptions, RigSettings

_BURST = 64
_CLOCK_LEAK_US = 1
_CLOCK_JUMP_US = 1_000_000


def _monotonic_us() -> int:
    return time.monotonic_ns() // 1000


class BusClock:
    """This host's monotonic clock, shifted to the time that the bus stamps on frames.

    A frame is read after it was stamped, so the largest difference seen is the nearest to the
    truth; it leaks by 1 us a frame, faster than two clocks drift apart. A difference that changes
    by more than a second is another clock (interfaces stamp as they like, and wall clocks are
    set), and taken as it is.
    """

    def __init__(self, monotonic_us: Callable[[], int] = _monotonic_us) -> None:
        self._monotonic_us = monotonic_us
        self._offset_us: int | None = None

    def stamp(self, timestamp_s: float) -> int:
        """The time of a frame in whole microseconds; the clock learns from it."""
        stamp_us = round(timestamp_s * 1e6)
        offset_us = stamp_us - self._monotonic_us()
        before_us = self._offset_us
        if before_us is not None and abs(offset_us - before_us) <= _CLOCK_JUMP_US:
            offset_us = max(offset_us, before_us - _CLOCK_LEAK_US)
        self._offset_us = offset_us
        return stamp_us

    def now(self) -> int | None:
        """The present on the bus's clock; None until a frame has told it."""
        return self.at(self._monotonic_us())

    def at(self, monotonic_us: int) -> int | None:
        """A time of this host's clock on the bus's; None until a frame has told it."""
        return None if self._offset_us is None else monotonic_us + self._offset_us


def open_bus(options: BusOptions) -> can.BusABC:
    """`can.Bus(**options)`. Raises SimRigError with python-can's reason."""
    arguments: dict[str, Any] = dict(options)
    try:
        return can.Bus(**arguments)
    except (can.CanError, OSError, ValueError, TypeError, ImportError) as error:
        raise SimRigError(
            f"The rig cannot open its bus {arguments}: {error}. "
            "Check interface, channel, and what else python-can's interface wants."
        ) from error


class RigOnBus:
    """A rig that answers on `bus`."""

    def __init__(self, settings: RigSettings, plant: Plant, bus: can.BusABC) -> None:
        self._bus = bus
        self._clock = BusClock()
        self._outgoing = Outgoing(bus)
        self.rig = Rig(settings, plant, self._outgoing.send)
        self._lock = threading.Lock()  # for who looks at the machine from another thread

    def run(self, stop: Callable[[], bool]) -> None:
        """Answer until `stop()`. Raises SimRigError when the bus is lost."""
        while not stop():
            self.step()

    def step(self) -> None:
        """Wait for a frame or a deadline, and do all that is due then."""
        now_us = self._clock.now()
        wait_us = RESTING_STEP_US if now_us is None else self.rig.wait_us(now_us)
        try:
            message = self._bus.recv(wait_us * 1e-6)
            burst = 0
            while message is not None:
                with self._lock, self._outgoing:
                    self._dispatch(message)
                burst += 1
                message = self._bus.recv(0) if burst < _BURST else None
            if not burst and hung_up(self._bus):
                raise can.CanError("the hub closed the connection")
            # A deadline is judged when every frame that has come is heard; on a bus that never
            # pauses, or a computer that is too slow for it, a node still says that it lives.
            now_us = self._clock.now()
            if now_us is not None:
                with self._lock, self._outgoing:
                    (self.rig.tick if burst < _BURST else self.rig.beat)(now_us)
        except (can.CanError, OSError) as error:
            raise SimRigError(f"The rig lost its bus: {self._why(error)}.") from error

    def _why(self, error: Exception) -> str:
        """In one line: python-can puts a whole traceback into its errors' words."""
        if hung_up(self._bus):
            return "the hub closed the connection. Start the rig again"
        words = " ".join(str(error).split("Traceback")[0].split())
        return f"{words.rstrip('. ')}. Start the rig again"

    def load_counts(self, monotonic_us: int) -> int:
        """The load encoder's count at a time of this host's clock, from any thread."""
        with self._lock:
            time_us = self._clock.at(monotonic_us)
            if time_us is not None:
                self.rig.machine.advance_to(time_us)
            return self.rig.encoder.sensor.counts(self.rig.machine.outputs.load_angle_rad)

    def _dispatch(self, message: can.Message) -> None:
        time_us = self._clock.stamp(message.timestamp)
        if message.is_extended_id or message.is_error_frame:
            return
        if message.is_remote_frame:
            self.rig.receive_remote(message.arbitration_id, time_us)
        else:
            self.rig.receive(message.arbitration_id, bytes(message.data), time_us)
