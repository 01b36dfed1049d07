"""The software rig and its master in one thread, on a time of their own: no socket, no sleep.

The slaves, their faults, and the bus's time are those of `sim_rig`; the master is that of
`drivers`; python-can stands between them as on any bus. A frame that the master sends is taken by
the rig before `send` returns, and time passes only while the master waits: a run repeats to the
bit on every machine. What it cannot show is what the wire itself does to a run.
"""

import itertools
from collections import deque
from weakref import WeakValueDictionary

import can
from can.interfaces import BACKENDS

from drivers.clock import Clock as DriversClock
from servo_bench.clock import NS_PER_S, Clock
from sim_rig.canopen.rig import Rig
from sim_rig.process import plant_of
from sim_rig.settings import RigSettings

INTERFACE = "servo-bench-virtual"
EPOCH_US = 1_700_000_000_000_000
BEGIN_NS = NS_PER_S
LOOK_NS = 1000
"""What a look at the clock takes, so that a loop that only looks at it ends."""

_NUMBERS = itertools.count()
_WIRES: "WeakValueDictionary[str, VirtualWire]" = WeakValueDictionary()


class VirtualWire:
    """A rig, its bus, and its time; `bus` are the options with which python-can opens it."""

    def __init__(self, settings: RigSettings) -> None:
        """Boot the rig. Raises RigSettingsError or EffectError where it cannot be."""
        BACKENDS[INTERFACE] = (__name__, VirtualBus.__name__)
        channel = str(next(_NUMBERS))
        self.bus: dict[str, str | int | float | bool] = {
            "interface": INTERFACE,
            "channel": channel,
        }
        self.now_ns = BEGIN_NS
        self._waiting: deque[can.Message] = deque()
        self._rig = Rig(settings, plant_of(settings), self._heard)
        self._rig.boot()
        self._waiting.clear()  # nobody listened yet
        _WIRES[channel] = self

    def drivers_clock(self) -> DriversClock:
        """The master's clock."""
        return DriversClock(
            self.look_at_clock, lambda s: self.pass_until(self.now_ns + round(s * NS_PER_S))
        )

    def run_clock(self) -> Clock:
        """The bus loop's clock."""
        return _RunClock(self)

    def look_at_clock(self) -> int:
        """The present in nanoseconds; looking takes a microsecond."""
        self.now_ns += LOOK_NS
        return self.now_ns

    def pass_until(self, end_ns: int, *, stop_on_frame: bool = False) -> None:
        """Let time pass, the rig doing what is due, until then or until a frame has come."""
        while self.now_ns < end_ns and not (stop_on_frame and self._waiting):
            step_ns = max(1000, self._rig.wait_us(self._now_us) * 1000)
            self.now_ns = min(self.now_ns + step_ns, end_ns)
            self._rig.tick(self._now_us)

    def send(self, can_id: int, data: bytes) -> None:
        """A frame from the master."""
        self._rig.receive(can_id, data, self._now_us)

    def ask(self, can_id: int) -> None:
        """A remote frame from the master."""
        self._rig.receive_remote(can_id, self._now_us)

    def receive(self, timeout_s: float) -> can.Message | None:
        """The next frame from the rig, or None when so much time has passed."""
        self.pass_until(self.now_ns + round(timeout_s * NS_PER_S), stop_on_frame=True)
        return self._waiting.popleft() if self._waiting else None

    @property
    def _now_us(self) -> int:
        return EPOCH_US + self.now_ns // 1000

    def _heard(self, can_id: int, data: bytes) -> None:
        self._waiting.append(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))


class VirtualBus(can.BusABC):
    """python-can's side of a `VirtualWire`."""

    def __init__(self, channel: str) -> None:
        """Open the wire of that name; it must be there."""
        self._wire = _WIRES[channel]
        self.channel_info = f"virtual wire {channel}"
        super().__init__(channel)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        """Give a frame to the rig."""
        if msg.is_remote_frame:
            self._wire.ask(msg.arbitration_id)
        else:
            self._wire.send(msg.arbitration_id, bytes(msg.data))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Wait in the wire's own time; for ever is what nobody may wait here."""
        if timeout is None:
            raise can.CanOperationError("a virtual wire cannot be waited on without end")
        return self._wire.receive(timeout)


class _RunClock(Clock):
    """The clock of a run, on a wire's time."""

    def __init__(self, wire: VirtualWire) -> None:
        self._wire = wire

    def now_ns(self) -> int:
        return self._wire.look_at_clock()

    def sleep_until(self, deadline_ns: int) -> int:
        self._wire.pass_until(deadline_ns)
        return self._wire.look_at_clock()
