"""Where a recording came from: versions, host, and how its clock lies to UTC. All of it text."""

import os
import platform
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from servo_bench import __version__
from servo_bench.clock import NS_PER_S, monotonic_ns

PACKAGES = ("numpy", "canopen", "python-can", "mcap")


class ClockPair(NamedTuple):
    """One instant on both clocks; the two readings lie at most `uncertainty_ns` apart."""

    monotonic_ns: int
    utc_ns: int
    uncertainty_ns: int


def clock_pair(
    monotonic: Callable[[], int] = monotonic_ns, utc: Callable[[], int] = time.time_ns
) -> ClockPair:
    """CLOCK_MONOTONIC and UTC of one instant: the tightest of several bracketed readings."""
    return min((_bracketed(monotonic, utc) for _ in range(16)), key=lambda pair: pair[2])


def _bracketed(monotonic: Callable[[], int], utc: Callable[[], int]) -> ClockPair:
    before_ns, utc_ns, after_ns = monotonic(), utc(), monotonic()
    half_ns = (after_ns - before_ns) // 2
    return ClockPair(before_ns + half_ns, utc_ns, after_ns - before_ns - half_ns)


def provenance(
    pair: ClockPair | None = None, command: Sequence[str] | None = None
) -> dict[str, str]:
    """The facts of this process on this host, now unless `pair` says when.

    Keys: `servo_bench`, `python`, and each of PACKAGES (versions); `platform`, `machine`,
    `cpu_count`; `clock_monotonic_ns`, `clock_utc_ns`, `clock_uncertainty_ns`,
    `clock_resolution_ns`; `utc` (ISO 8601) and `command` (without anyone's home folder in it).
    """
    pair = pair or clock_pair()
    began = datetime.fromtimestamp(pair.utc_ns / NS_PER_S, UTC)
    return {
        "servo_bench": __version__,
        "python": platform.python_version(),
        **{package: version(package) for package in PACKAGES},
        "platform": f"{platform.system()} {platform.release()}",
        "machine": platform.machine(),
        "cpu_count": str(os.cpu_count()),
        "clock_monotonic_ns": str(pair.monotonic_ns),
        "clock_utc_ns": str(pair.utc_ns),
        "clock_uncertainty_ns": str(pair.uncertainty_ns),
        "clock_resolution_ns": str(round(time.clock_getres(time.CLOCK_MONOTONIC) * NS_PER_S)),
        "utc": began.isoformat(timespec="seconds"),
        "command": command_text(sys.argv if command is None else command, Path.home()),
    }


def command_text(command: Sequence[str], home: Path) -> str:
    """A command line for others to read: the program's name, and ~ for the home folder."""
    if not command:
        return ""
    words = [Path(command[0]).name, *command[1:]]
    text = " ".join(word.replace(str(home), "~") for word in words)
    return text.encode(errors="replace").decode()  # a file's name need be no UTF-8


def utc_offset_ns(facts: Mapping[str, str]) -> int:
    """What to add to CLOCK_MONOTONIC for UTC; 0 where the facts do not say."""
    try:
        return int(facts["clock_utc_ns"]) - int(facts["clock_monotonic_ns"])
    except (KeyError, ValueError):
        return 0
