"""A rig and its bench in one thread, on a time of their own: no socket to the outside, no sleep.

Time passes only while the master waits, or, by a microsecond, when it looks at its clock. What the
rig has to do is done when it is due; its lines (`tests.virtual_line`) hear what the master has
written whenever it looks or waits.
"""

import heapq
import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable

from drivers.clock import Clock as DriversClock
from servo_bench.clock import Clock

LOOK_NS = 1000


class VirtualWorld(ABC):
    """The rig's side of a run."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000
        self.lines: list[VirtualEnd] = []

    @property
    @abstractmethod
    def powered(self) -> bool:
        """Whether the drive really holds the motor, whatever it says."""

    @property
    @abstractmethod
    def velocity_rad_s(self) -> float:
        """The motor's true velocity."""

    @abstractmethod
    def rig_wait_us(self) -> int:
        """How long the rig has nothing to do."""

    @abstractmethod
    def rig_tick(self) -> None:
        """Do what is due."""

    def clock(self) -> DriversClock:
        """The master's clock."""
        return DriversClock(
            self.look_at_clock, lambda s: self.pass_until(self.now_ns + round(s * 1e9))
        )

    def look_at_clock(self) -> int:
        """The time, a little later than before."""
        self._hear()
        self.now_ns += LOOK_NS
        return self.now_ns

    def pass_until(self, end_ns: int, stop: Callable[[], object] = lambda: False) -> None:
        """Let time pass, the rig doing what is due, until then or until `stop()`."""
        self._hear()
        while self.now_ns < end_ns and not stop():
            due_ns = self.now_ns + max(LOOK_NS, self.rig_wait_us() * 1000)
            for line in self.lines:
                due_ns = min(due_ns, max(line.due_ns(), self.now_ns))
            self.now_ns = min(due_ns, end_ns)
            self.rig_tick()
            for line in self.lines:
                line.tick(self.now_ns)

    def _hear(self) -> None:
        for line in self.lines:
            line.hear()


class VirtualEnd(ABC):
    """A far end of one of the world's lines: hears bytes, and does things at their time."""

    def __init__(self) -> None:
        self._plans: list[tuple[int, int, Callable[[], None]]] = []
        self._numbers = itertools.count()

    @abstractmethod
    def hear(self) -> None:
        """Take what the master has written."""

    def at(self, due_ns: float, act: Callable[[], None]) -> None:
        """Have `act` called at a time."""
        heapq.heappush(self._plans, (round(due_ns), next(self._numbers), act))

    def due_ns(self) -> int:
        """When `tick` is wanted."""
        return self._plans[0][0] if self._plans else 1 << 62

    def tick(self, now_ns: int) -> None:
        """Do what is due."""
        while self._plans and self._plans[0][0] <= now_ns:
            heapq.heappop(self._plans)[2]()


class RunClock(Clock):
    """The run's clock on a rig's time; at its `stall_at`-th wait the bench sleeps too long."""

    def __init__(self, world: VirtualWorld, stall_at: int = -1, stall_s: float = 0.0) -> None:
        self._world = world
        self._waits_left = stall_at
        self._stall_ns = round(stall_s * 1e9)

    def now_ns(self) -> int:
        return self._world.look_at_clock()

    def sleep_until(self, deadline_ns: int) -> int:
        late_ns = self._stall_ns if self._waits_left == 0 else 0
        self._waits_left -= 1
        self._world.pass_until(deadline_ns + late_ns)
        return self._world.look_at_clock()
