"""What the kernel is asked for before the bus loop starts, and what it said.

Nothing here is needed for a correct run, only for a punctual one: a refusal becomes a plain
sentence that the recording and the operator get, never an error.
"""

import ctypes
import gc
import os
import sys

PR_SET_PDEATHSIG = 1
PR_SET_TIMERSLACK = 29
MCL_CURRENT_AND_FUTURE = 1 | 2
SWITCH_INTERVAL_S = 0.0005
PRIORITY = 80
"""SCHED_FIFO priority of the bus loop, where nobody says another."""


def make_punctual(priority: int) -> tuple[str, ...]:
    """Ask for SCHED_FIFO, locked memory, and fine timers; freeze the garbage collector.

    Returns a sentence for everything that was refused; an empty tuple is the best case. Linux
    only in its effects: elsewhere it says so and goes on.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    if not sys.platform.startswith("linux"):
        return (f"{sys.platform} offers no SCHED_FIFO here: expect milliseconds of lateness.",)
    return tuple(
        sentence for sentence in (_fine_timers(), _locked_memory(), _fifo(priority)) if sentence
    )


def make_prompt(priority: int) -> None:
    """Ask for SCHED_FIFO and fine timers for a process that watches; what is refused is done
    without."""
    if sys.platform.startswith("linux"):
        _fine_timers()
        if priority > 0:
            _fifo(priority)


def follow_parent(signal_number: int, parent_pid: int) -> bool:
    """Have the kernel send `signal_number` to this process when its parent dies.

    False where it has died already, which the kernel does not tell.
    """
    if sys.platform.startswith("linux"):
        _libc().prctl(PR_SET_PDEATHSIG, signal_number, 0, 0, 0)
    return os.getppid() == parent_pid


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _fine_timers() -> str | None:
    if _libc().prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0) == 0:
        return None
    return f"The kernel kept its timer slack ({os.strerror(ctypes.get_errno())}): +50 us lateness."


def _locked_memory() -> str | None:
    if _libc().mlockall(MCL_CURRENT_AND_FUTURE) == 0:
        return None
    return (
        f"Memory could not be locked ({os.strerror(ctypes.get_errno())}): under memory pressure a "
        "page fault may delay a cycle. Raise `ulimit -l`."
    )


def _fifo(priority: int) -> str | None:
    if priority == 0:
        return "SCHED_FIFO was not asked for (priority 0): on a busy machine cycles will be late."
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        return (
            "SCHED_FIFO was refused: on a busy machine cycles will be late. Allow it with an "
            "rtprio line in /etc/security/limits.conf, or run as root."
        )
    return None
