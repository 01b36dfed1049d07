"""Time as the masters see it; tests put another one in its place."""

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Clock:
    """CLOCK_MONOTONIC in nanoseconds, and a way to let time pass."""

    now_ns: Callable[[], int] = time.monotonic_ns
    sleep_s: Callable[[float], None] = time.sleep

    def sleep_until(self, deadline_ns: int) -> None:
        """Return at `deadline_ns`, at once where it has passed."""
        remaining_ns = deadline_ns - self.now_ns()
        if remaining_ns > 0:
            self.sleep_s(remaining_ns * 1e-9)


SYSTEM_CLOCK = Clock()
