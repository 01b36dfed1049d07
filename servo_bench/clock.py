"""Absolute deadlines on CLOCK_MONOTONIC.

A slot's deadline is `start + slot * period`; nothing accumulates. `time.sleep` of CPython >= 3.11
is clock_nanosleep on CLOCK_MONOTONIC, so sleeping the difference to a deadline is as good as an
absolute sleep, less the microsecond in which the difference is taken.
"""

import time
from dataclasses import dataclass

NS_PER_S = 1_000_000_000


def monotonic_ns() -> int:
    """CLOCK_MONOTONIC in nanoseconds."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC)


class Clock:
    """The clock of a run; tests inject one that jumps."""

    def now_ns(self) -> int:
        """CLOCK_MONOTONIC in nanoseconds."""
        return monotonic_ns()

    def sleep_until(self, deadline_ns: int) -> int:
        """Sleep to the deadline and return the time of waking; at once where it has passed."""
        now_ns = monotonic_ns()
        if now_ns < deadline_ns:
            time.sleep((deadline_ns - now_ns) / NS_PER_S)
            now_ns = monotonic_ns()
        return now_ns


@dataclass(frozen=True, slots=True)
class Grid:
    """The deadlines of a run: slot k is due at `start_ns + k * period_ns`."""

    start_ns: int
    period_ns: int

    def deadline_ns(self, slot: int) -> int:
        """When `slot` is due."""
        return self.start_ns + slot * self.period_ns

    def due(self, slot: int, now_ns: int) -> int:
        """The slot to play at `now_ns` when `slot` was next.

        It is `slot` itself until the deadline after it has passed; then the slots in between are
        lost, and playing goes on with the one whose time it is. Never an earlier one.
        """
        return max(slot, (now_ns - self.start_ns) // self.period_ns)
