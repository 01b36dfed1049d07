"""The bus process of a runner that has died: found by its command line, waited for, ended.

The bus loop stops the rig by itself when its session dies (the kernel tells it). Until it has
ended nobody else may be master on the bus.
"""

import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from servo_bench.run.command_line import bus_loop_command

LOOK_EVERY_S = 0.02


def bus_processes(runner_pid: int) -> list[int]:
    """Process ids of the bus loops that the session `runner_pid` has started and that live."""
    wanted = [word.encode() for word in bus_loop_command(runner_pid)[1:]]
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with suppress(OSError):  # it has ended meanwhile
                if (folder / "cmdline").read_bytes().split(b"\0")[1:-1] == wanted:
                    found.append(int(folder.name))
    return found


def wait_for_bus_processes(
    runner_pid: int, patience_s: float, sleep_s: Callable[[float], None] = time.sleep
) -> bool:
    """Wait until the bus loops of a dead runner have stopped the rig and ended.

    What still lives after `patience_s` is killed: the drive then misses its master and stops by
    itself. False where that was needed.
    """
    for _ in range(round(patience_s / LOOK_EVERY_S)):
        if not bus_processes(runner_pid):
            return True
        sleep_s(LOOK_EVERY_S)
    for pid in (left := bus_processes(runner_pid)):
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    return not left
