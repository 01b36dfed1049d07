"""sd_notify(3) in the few lines that it is: systemd's readiness and watchdog."""

import os
import socket
from collections.abc import Mapping

US_PER_S = 1_000_000
PATIENCE_S = 0.1
"""A listener that does not read must not hold up the daemon: its next sign of life comes anyway."""


def notify(*states: str, environment: Mapping[str, str] = os.environ) -> bool:
    """Tell systemd, e.g. "READY=1"; False where nobody listens, or nobody reads."""
    address = environment.get("NOTIFY_SOCKET", "")
    if not address:
        return False
    if address.startswith("@"):  # the abstract name space
        address = "\0" + address[1:]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
        sender.settimeout(PATIENCE_S)
        try:
            sender.sendto("\n".join(states).encode(), address)
        except OSError:
            return False
    return True


def watchdog_s(environment: Mapping[str, str] = os.environ) -> float | None:
    """How long systemd waits for a sign of life, where it was told to watch this process."""
    if environment.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None
    try:
        return int(environment["WATCHDOG_USEC"]) / US_PER_S
    except (KeyError, ValueError):
        return None
