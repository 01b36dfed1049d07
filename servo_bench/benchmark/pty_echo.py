"""What a pty of this machine takes by itself: bytes there and back, beside a run over another pty.

    python -m servo_bench.benchmark.pty_echo     (period_s, pings, priority as JSON on stdin)

The kernel hands a pty's bytes over in a worker of ordinary priority: on a busy machine that takes
milliseconds, whatever the priority of both ends. Two processes at the loop's own priority, one byte
per period; prints the round trips in seconds as one JSON list, of those that came within a period.
"""

import contextlib
import json
import os
import select
import sys
import time
import tty

from servo_bench.clock import NS_PER_S, Clock, monotonic_ns


def _echo(far: int) -> None:
    """The other end, until it hangs up."""
    with contextlib.suppress(OSError):
        while data := os.read(far, 64):
            os.write(far, data)
    os._exit(0)


def ping(period_s: float, pings: int, priority: int) -> list[float]:
    """Round trips in seconds, infinity where a byte had not come back by the next ping."""
    near, far = os.openpty()
    tty.setraw(far)
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    if os.fork() == 0:
        os.close(near)
        _echo(far)
    os.close(far)
    clock, start_ns, took_s = Clock(), monotonic_ns(), []
    for turn in range(pings):
        clock.sleep_until(start_ns + round(turn * period_s * NS_PER_S))
        while select.select([near], [], [], 0.0)[0]:
            os.read(near, 64)  # too late
        begun_s = time.monotonic()
        os.write(near, b"x")
        came = bool(select.select([near], [], [], period_s)[0])
        if came:
            os.read(near, 64)
        took_s.append(time.monotonic() - begun_s if came else float("inf"))
    os.close(near)
    return took_s


if __name__ == "__main__":
    job = json.loads(sys.stdin.readline())
    sys.stdout.write(json.dumps(ping(job["period_s"], job["pings"], job["priority"])))
