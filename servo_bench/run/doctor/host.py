"""This computer: may the bus loop be punctual, and is its clock good for it?"""

import os
import resource
import time
from pathlib import Path

import numpy as np

from servo_bench.clock import NS_PER_S, monotonic_ns
from servo_bench.run.finding import Finding, change, note, ok
from servo_bench.run.realtime import PRIORITY

LOCKED_BYTES = 128 << 20
"""What a bus loop and its supervisor hold, with room."""
WAKEUPS = 100
_WAKE_EVERY_S = 0.002
_LATE_S = 0.001
_CLOCKSOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
_GOVERNORS = Path("/sys/devices/system/cpu")


def examine() -> list[Finding]:
    """Scheduling rights, locked memory, clock, and how late this process wakes up now."""
    return [_fifo(), _memory(), _clock(), *_governor(), _wakeups(), _processors()]


def _fifo() -> Finding:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        return change(
            "scheduling",
            f"SCHED_FIFO at priority {PRIORITY} is refused: on a busy machine cycles will be late. "
            f"Put '@realtime - rtprio {PRIORITY + 10}' into /etc/security/limits.d/realtime.conf, "
            "join the group realtime, log in again.",
        )
    os.sched_setscheduler(0, *before)
    return ok("scheduling", f"SCHED_FIFO at priority {PRIORITY} is granted.")


def _memory() -> Finding:
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft == resource.RLIM_INFINITY or soft >= LOCKED_BYTES or os.geteuid() == 0:
        return ok("locked memory", "the bus loop may lock its memory.")
    return change(
        "locked memory",
        f"{soft >> 20} MiB may be locked, the bus loop wants {LOCKED_BYTES >> 20}: a page fault "
        "may delay a cycle. Put '@realtime - memlock unlimited' into "
        "/etc/security/limits.d/realtime.conf.",
    )


def _clock() -> Finding:
    resolution_s = time.clock_getres(time.CLOCK_MONOTONIC)
    source = _CLOCKSOURCE.read_text().strip() if _CLOCKSOURCE.exists() else "unknown"
    text = f"CLOCK_MONOTONIC from {source}, resolution {resolution_s * 1e9:g} ns"
    if resolution_s > 1e-6 or source in ("hpet", "acpi_pm", "refined-jiffies"):
        return change("clock", f"{text}: slow to read or coarse. Boot with clocksource=tsc.")
    return ok("clock", f"{text}.")


def _governor() -> list[Finding]:
    found = {path.read_text().strip() for path in _GOVERNORS.glob("cpu*/cpufreq/scaling_governor")}
    if not found:
        return []
    text = f"processors' frequency: {', '.join(sorted(found))}"
    if found <= {"performance"}:
        return [ok("governor", f"{text}.")]
    return [note("governor", f"{text}: 'performance' wakes up sooner (cpupower frequency-set).")]


def _wakeups() -> Finding:
    begun_ns, every_ns = monotonic_ns(), round(_WAKE_EVERY_S * NS_PER_S)
    late_s = []
    for count in range(1, WAKEUPS + 1):
        deadline_ns = begun_ns + count * every_ns
        time.sleep(max(0, deadline_ns - monotonic_ns()) / NS_PER_S)
        late_s.append((monotonic_ns() - deadline_ns) / NS_PER_S)
    median_s, worst_s = float(np.median(late_s)), max(late_s)
    text = (
        f"{WAKEUPS} wake-ups without any priority: {median_s * 1e6:.0f} us late at the median, "
        f"{worst_s * 1e6:.0f} us at the worst"
    )
    if median_s > _LATE_S:
        return change("wake-ups", f"{text}: the machine is overloaded. See what runs on it.")
    return ok("wake-ups", f"{text}; servo-bench benchmark cycle measures the bus loop itself.")


def _processors() -> Finding:
    allowed = len(os.sched_getaffinity(0))
    if allowed < 2:
        return change("processors", "one processor: bus loop and supervisor need one each.")
    return ok("processors", f"{allowed} may be used.")
