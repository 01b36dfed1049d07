"""Whose clock a run keeps: this host's, or that of a drive that produces SYNC.

A *tick* is one SYNC: a slot, or one of the several samples that a slot can have.

    this host   tick k is due at start + k * period; one whose time has passed is skipped
    the drive   a tick is its next SYNC, and `Axis.command` waits for it; one that came before the
                command could go out is skipped
"""

from typing import Protocol, runtime_checkable

from drivers.axis import Axis
from servo_bench.clock import NS_PER_S, Clock, Grid
from servo_bench.errors import ConfigError


class Pace(Protocol):
    """When the next tick is, and until when its answers may be waited for."""

    def wake(self, tick: int) -> int:
        """Wait for the turn of `tick`: the time of waking."""
        ...

    def due(self, tick: int, woken_ns: int) -> int:
        """Which tick it is, `tick` or a later one; asked when all that had come was taken."""
        ...

    def lateness_s(self, tick: int, woken_ns: int, asked_ns: int) -> float:
        """How late the tick that was asked is; to be called once for each, in order."""
        ...

    def until_ns(self, tick: int) -> int:
        """When the loop must be free for the next tick."""
        ...


class HostPace:
    """Absolute deadlines on this host's clock."""

    def __init__(self, clock: Clock, start_ns: int, period_s: float) -> None:
        self._clock = clock
        self._grid = Grid(start_ns, round(period_s * NS_PER_S))
        self._margin_ns = min(self._grid.period_ns // 8, 500_000)

    def wake(self, tick: int) -> int:
        """See `Pace.wake`."""
        return self._clock.sleep_until(self._grid.deadline_ns(tick))

    def due(self, tick: int, woken_ns: int) -> int:
        """See `Pace.due`."""
        return self._grid.due(tick, woken_ns)

    def lateness_s(self, tick: int, woken_ns: int, asked_ns: int) -> float:  # noqa: ARG002
        """Wake-up after the deadline."""
        return (woken_ns - self._grid.deadline_ns(tick)) / NS_PER_S

    def until_ns(self, tick: int) -> int:
        """See `Pace.until_ns`."""
        return self._grid.deadline_ns(tick + 1) - self._margin_ns


@runtime_checkable
class Follower(Protocol):
    """An axis whose drive produces SYNC."""

    def next_slot(self, slot: int) -> int:
        """Which tick the next SYNC is: `slot`, or a later one."""
        ...


class DrivePace:
    """The drive's SYNCs, as they come."""

    def __init__(self, clock: Clock, axis: Follower, period_s: float) -> None:
        self._clock = clock
        self._axis = axis
        self._period_ns = round(period_s * NS_PER_S)
        self._last: tuple[int, int] | None = None

    def wake(self, tick: int) -> int:  # noqa: ARG002
        """See `Pace.wake`; waits for nothing, because `Axis.command` does."""
        return self._clock.now_ns()

    def due(self, tick: int, woken_ns: int) -> int:  # noqa: ARG002
        """See `Pace.due`: a SYNC that came while samples were taken asked for nobody's slot."""
        return self._axis.next_slot(tick)

    def lateness_s(self, tick: int, woken_ns: int, asked_ns: int) -> float:  # noqa: ARG002
        """How much later than a period after the SYNC before it a SYNC was taken; may be < 0."""
        before, self._last = self._last, (tick, asked_ns)
        if before is None:
            return 0.0
        return (asked_ns - before[1] - (tick - before[0]) * self._period_ns) / NS_PER_S

    def until_ns(self, tick: int) -> int:  # noqa: ARG002
        """Half a period after the SYNC: the command for the next one has time to get there."""
        asked_ns = self._last[1] if self._last else self._clock.now_ns()
        return asked_ns + self._period_ns // 2


def pace_of(axis: Axis, clock: Clock, start_ns: int, tick_s: float, *, by_drive: bool) -> Pace:
    """The pace of a run; ConfigError where this axis cannot follow its drive."""
    if not by_drive:
        return HostPace(clock, start_ns, tick_s)
    if not isinstance(axis, Follower):
        raise ConfigError(
            f'drive.sync = "drive" is not possible with {type(axis).__name__}, which follows '
            'nobody\'s SYNC. Set drive.sync = "master".'
        )
    return DrivePace(clock, axis, tick_s)
