"""What the operating system can do for a process that must answer in time; Linux, best effort."""

import ctypes
import gc
import os
import signal

_PR_SET_PDEATHSIG = 1
_PR_SET_TIMERSLACK = 29


def _prctl(option: int, value: int) -> None:
    """prctl(2); a kernel that refuses leaves the process as it was."""
    ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0)


def run_in_real_time(priority: int) -> bool:
    """SCHED_FIFO at `priority`, timers to the nanosecond, what exists kept out of the collector.

    Returns whether the scheduler agreed; without the privilege the process runs on as it was.
    """
    gc.collect()
    gc.freeze()
    _prctl(_PR_SET_TIMERSLACK, 1)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True


def end_with_parent(parent_pid: int) -> bool:
    """Have the kernel send SIGTERM to this process when its parent dies.

    Returns False where the parent `parent_pid` is dead already. The kernel watches the thread
    that started this process: start it from one that lives as long as it is needed.
    """
    _prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    return os.getppid() == parent_pid
