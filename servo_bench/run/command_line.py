"""How the bus process is started, and known again by whoever finds it."""

import sys


def bus_loop_command(session_pid: int) -> list[str]:
    """Its command line, for the session of that process id. No module comes out of the working
    folder (-P): somebody may have a `can.py` there."""
    return [sys.executable, "-P", "-m", "servo_bench.run.busloop", str(session_pid)]
