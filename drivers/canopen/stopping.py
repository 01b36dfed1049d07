"""How a drive stops, and what makes it stop by itself when its master has died."""

from collections.abc import Callable

from drivers.canopen.node import Node
from drivers.canopen.pdo import RPDO
from drivers.canopen.profile import Address, Stopping
from drivers.canopen.settings import CanopenSettings

Note = Callable[[str, str], None]

_EVENT_TIMER = 5


def watch_master(node: Node, settings: CanopenSettings, note: Note) -> Address | None:
    """Let the drive stop by itself when this master falls silent.

    Returns the object that arms it (0 disarms), None where the drive cannot.
    """
    drive = settings.drive
    timeout_ms = round(drive.heartbeat_timeout_s * 1e3)
    armed: Address | None = None
    value = timeout_ms
    if drive.profile.stopping.watchdog == "heartbeat":
        armed, value = (0x1016, 1), settings.master_node_id << 16 | timeout_ms
    elif drive.profile.stopping.watchdog == "rpdo-timer":
        armed = (RPDO + drive.profile.command.pdo - 1, _EVENT_TIMER)
    if armed is None or not node.writable(*armed):
        lacking = "watchdog by its profile" if armed is None else f"0x{armed[0]:04X}:{armed[1]}"
        if armed == (0x1016, 1):
            lacking = "0x1016"
        note(
            "master not watched",
            f"{node.name} has no {lacking}: it does not stop by itself when this master dies.",
        )
        return None
    node.configure(*armed, value)
    return armed


def prepare_stop(node: Node, stopping: Stopping) -> None:
    """Write what the drive does at a quick stop (0x605A) and without a master (0x6007)."""
    for index, reaction in (
        (0x6007, stopping.connection_lost_option),
        (0x605A, stopping.quick_stop_option),
    ):
        if reaction is not None and node.writable(index):
            node.configure(index, 0, reaction)
