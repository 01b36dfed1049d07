"""The safety supervisor: a process of its own beside the bus loop, that stops the rig without it.

    session ── starts ──▶ bus loop ── forks, before anything is opened ──▶ supervisor
                             └───── slot table (shared memory) ─────▶ judge ─┘   └─▶ stop line

It reads the slot table, hears the wire by a connection of its own where the bus has several owners,
and asks `servo_bench.run.judge` a few hundred times a second. On a trip, in this order: the cause
is latched in shared memory; the loop is killed, so that nobody commands the drive any more; quick
stop, velocity zero, disable go out; only then is anything said. It outlives the session and ends
with the loop.

It is no safety function: a rig needs a hard-wired emergency stop or STO of its own.
"""

import os
import select
import signal
import time
import traceback
from collections.abc import Callable
from contextlib import suppress

from drivers.errors import DriverError
from drivers.stopline import StopLine
from servo_bench.clock import NS_PER_S, monotonic_ns
from servo_bench.errors import BenchError, WireError, gathered
from servo_bench.rig import RigConfig
from servo_bench.run.axes import stop_line
from servo_bench.run.judge import Judge
from servo_bench.run.realtime import make_prompt
from servo_bench.run.table import SlotTable, Trip

BEGIN_TIMEOUT_S = 10.0
STALE_S = 2.0
"""A supervisor that has not looked for so long is none: the loop stops the rig."""
TEMPERATURE_EVERY_S = 1.0
KILL_TIMEOUT_S = 0.5
_POLL_S = (0.001, 0.01)
_AWAIT_S = 0.001
Tell = Callable[..., None]


def start(rig: RigConfig, period_s: float, table: SlotTable, priority: int, tell: Tell) -> None:
    """Fork the supervisor of this process; returns in this process when it watches.

    This process must have one thread. Raises WireError where the supervisor does not begin.
    """
    loop = os.pidfd_open(os.getpid())
    pid = os.fork()
    if pid == 0:
        _be(rig, period_s, table, loop, priority=priority, tell=tell)
    os.close(loop)
    begun_ns = monotonic_ns()
    while not table.watch_ns:
        ended, _ = os.waitpid(pid, os.WNOHANG)
        if ended or monotonic_ns() - begun_ns > BEGIN_TIMEOUT_S * NS_PER_S:
            raise WireError(
                "the safety supervisor did not begin to watch: nothing was enabled. Look at this "
                "terminal for a traceback, and run again."
            )
        time.sleep(_AWAIT_S)


def check_watched(table: SlotTable, now_ns: int) -> None:
    """Raise WireError where there was a supervisor and it looks no more."""
    watched_ns = table.watch_ns
    if watched_ns and now_ns - watched_ns > STALE_S * NS_PER_S:
        raise WireError(
            f"the safety supervisor has not looked for {(now_ns - watched_ns) / NS_PER_S:.1f} s in "
            f"slot {table.slot}: it was killed or hangs. The rig was stopped. Run again."
        )


def _be(
    rig: RigConfig, period_s: float, table: SlotTable, loop: int, *, priority: int, tell: Tell
) -> None:
    """The child's whole life; never returns."""
    status = 1
    try:
        os.setsid()  # what ends the loop's process group does not end its supervisor
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)  # it ends with the loop
        make_prompt(priority - 1)
        Supervisor(table, loop, Judge(rig, period_s), tell).watch(_opened(rig, period_s, tell))
        status = 0
    finally:
        if status:
            traceback.print_exc()
        os._exit(status)


def _opened(rig: RigConfig, period_s: float, tell: Tell) -> StopLine | None:
    """The stop line; None where there can be none, which the loop will meet and say itself."""
    try:
        with gathered():
            line = stop_line(rig, period_s)
            tell("supervised", line.open())
            return line
    except BenchError as error:
        tell("supervised", f"without a way of its own to the drive: {error}")
        return None


class Supervisor:
    """Watches one loop, whose pidfd is `loop`, until it has ended."""

    def __init__(self, table: SlotTable, loop: int, judge: Judge, tell: Tell) -> None:
        self._table = table
        self._loop = loop
        self._judge = judge
        self._tell = tell
        shortest_s, longest_s = _POLL_S
        self._poll_s = min(max(judge.period_s / 2, shortest_s), longest_s)
        self._next_temperature_ns = 0

    def watch(self, line: StopLine | None) -> None:
        """Look until the loop has ended, or the rig had to be stopped."""
        gone = False
        trip: Trip | None = None
        while not gone and trip is None:
            gone = bool(select.select([self._loop], [], [], self._poll_s)[0])
            now_ns = monotonic_ns()
            try:
                heard = line.poll() if line else ()
                temperature_c = self._temperature_c(line, now_ns)
            except DriverError as error:
                self._tell("supervisor deaf", str(error))
                heard, temperature_c, line = (), None, _reopened(line)
            trip = self._judge.look(
                now_ns, self._table, loop_is_gone=gone, heard=heard, temperature_c=temperature_c
            )
            self._table.watch_ns = now_ns
        if trip is not None:
            self._stop(trip, line)
        if line is not None:
            line.close()

    def _temperature_c(self, line: StopLine | None, now_ns: int) -> float | None:
        if not self._judge.wants_temperature or now_ns < self._next_temperature_ns:
            return None
        self._next_temperature_ns = now_ns + round(TEMPERATURE_EVERY_S * NS_PER_S)
        told_c = line.temperature_c() if line else None
        return self._table.temperature_c if told_c is None else told_c

    def _stop(self, trip: Trip, line: StopLine | None) -> None:
        tripped_ns = monotonic_ns()
        self._table.latch(trip, tripped_ns)
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._loop, signal.SIGKILL)
        select.select([self._loop], [], [], KILL_TIMEOUT_S)  # what it held is free when it is dead
        problem = "there is no way to it but the bus loop's" if line is None else line.stop()
        stopped_ns = monotonic_ns()
        self._tell("trip", trip.text, time_ns=tripped_ns, cause=trip.kind)
        took_s = (stopped_ns - tripped_ns) / NS_PER_S
        how = problem or f"stopped and disabled the drive, confirmed after {took_s:.3f} s"
        self._tell("supervisor's stop", how, time_ns=stopped_ns, took_s=took_s)


def _reopened(line: StopLine | None) -> StopLine | None:
    """A line that has failed is let go of; `stop` opens it anew."""
    if line is not None:
        line.close()
    return line
