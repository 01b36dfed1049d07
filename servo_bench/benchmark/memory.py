"""Memory that a run's processes take for themselves, watched from its progress.

Anonymous pages only (RssAnon of proc(5)): the table of slots is shared, of the run's own length,
and touched as it fills.
"""

import os
from pathlib import Path
from typing import Any

_LOOP = b"servo_bench.run.busloop"


class MemoryWatch:
    """Called with a run's progress; keeps a reading of both processes each time."""

    def __init__(self) -> None:
        self._session_mb: list[float] = []
        self._loop_mb: list[float] = []

    def look(self) -> None:
        """Read both processes now."""
        loop_mb = sum(_anonymous_mb(pid) for pid in _loops())
        if loop_mb > 0.0:  # it has begun, and has not ended
            self._session_mb.append(_anonymous_mb(os.getpid()))
            self._loop_mb.append(loop_mb)

    def figures(self) -> dict[str, Any]:
        """MB a tenth into the run, in its middle, and at its end; nothing of a run too short."""
        series = {"session": self._session_mb, "loop": self._loop_mb}
        return {name: _told(readings) for name, readings in series.items() if len(readings) > 1}


def _told(readings: list[float]) -> dict[str, float]:
    count = len(readings)
    return {
        "early_mb": readings[count // 10],
        "middle_mb": readings[count // 2],
        "last_mb": readings[-1],
        "most_mb": max(readings),
    }


def _loops() -> list[int]:
    """This session's bus loop and its supervisor."""
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    return [int(child) for child in children if _LOOP in _command(int(child))]


def _command(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:  # it has just ended
        return b""


def _anonymous_mb(pid: int) -> float:
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    kilobytes = next((line for line in status.splitlines() if line.startswith("RssAnon")), "0 0 0")
    return int(kilobytes.split()[1]) / 1e3
