"""How a drive stops, and what makes it stop by itself when its master has died."""

from collections.abc import Callable

from drivers.canopen import cia402
from drivers.canopen.cia402 import State
from drivers.canopen.guarding import (
    GUARD_TIME,
    LIFE_TIME_FACTOR,
    carries_remote_frames,
    guard_times,
)
from drivers.canopen.node import Node
from drivers.canopen.pdo import RPDO
from drivers.canopen.profile import Address, Stopping
from drivers.canopen.settings import CanopenSettings
from drivers.errors import SettingsError

Note = Callable[[str, str], None]

_EVENT_TIMER = 5
_POLL_S = 0.01
_SETTLE_S = 0.2
_STILL_COUNTS = 8
"""A position that stays within so many counts for `_SETTLE_S` stands, whatever dithers."""


def watch_master(node: Node, settings: CanopenSettings, note: Note) -> Address | None:
    """Let the drive stop by itself when this master falls silent.

    Returns the object that arms it (0 disarms), None where the drive cannot and the rig's
    configuration acknowledges it. Raises SettingsError where it does not.
    """
    drive = settings.drive
    timeout_ms = round(drive.heartbeat_timeout_s * 1e3)
    armed: Address | None = None
    value = timeout_ms
    watchdog = drive.profile.stopping.watchdog
    if watchdog == "heartbeat":
        armed, value = (0x1016, 1), settings.master_node_id << 16 | timeout_ms
    elif watchdog == "node-guarding":
        armed = LIFE_TIME_FACTOR
        guard_ms, value = guard_times(drive.heartbeat_s, drive.heartbeat_timeout_s)
    elif watchdog == "rpdo-timer":
        armed = (RPDO + drive.profile.command.pdo - 1, _EVENT_TIMER)
    if lacking := _what_lacks(node, settings, armed):
        if not drive.without_watchdog:
            raise SettingsError(
                f"{node.name} has no {lacking}: it would not stop by itself if the bench died. "
                "Only with an emergency stop at hand, set drive.without_watchdog = true to drive "
                "it all the same."
            )
        note(
            "master not watched",
            f"{node.name} has no {lacking}: it does not stop by itself when this master dies; the "
            "operator has acknowledged it (drive.without_watchdog).",
        )
        return None
    assert armed is not None  # noqa: S101 - else something lacks
    if armed == LIFE_TIME_FACTOR:
        node.configure(*GUARD_TIME, guard_ms)
    node.configure(*armed, value)
    return armed


def _what_lacks(node: Node, settings: CanopenSettings, armed: Address | None) -> str | None:
    """What keeps the drive from watching its master, in words; None where nothing does."""
    if armed is None:
        return "watchdog by its profile"
    if armed == LIFE_TIME_FACTOR:
        if not carries_remote_frames(settings.bus):
            return (
                "node guarding on this bus: python-can's interface "
                f"{settings.bus.get('interface')} carries no remote frames"
            )
        if not node.writable(*GUARD_TIME):
            return "0x100C"
    if node.writable(*armed):
        return None
    return f"0x{armed[0]:04X}:{armed[1]}" if armed[0] >= RPDO else f"0x{armed[0]:04X}"


def without_heartbeat(node: Node, settings: CanopenSettings) -> bool:
    """Whether this drive is to be guarded: a node that has a heartbeat time answers no question."""
    return (
        settings.drive.profile.stopping.watchdog == "node-guarding"
        and _what_lacks(node, settings, LIFE_TIME_FACTOR) is None
    )


def prepare_stop(node: Node, stopping: Stopping) -> None:
    """Write what the drive does at a quick stop (0x605A) and without a master (0x6007)."""
    for index, reaction in (
        (0x6007, stopping.connection_lost_option),
        (0x605A, stopping.quick_stop_option),
    ):
        if reaction is not None and node.writable(index):
            node.configure(index, 0, reaction)


def stop_by_sdo(node: Node, timeout_s: float) -> bool:
    """Quick stop, then power off, by SDO alone; whether the drive says that it is off.

    For a drive that takes no PDO, or whose master has gone. One whose quick stop holds the axis
    (0x605A from 5 on) is powered off when it has stood for a while, any at the timeout. Errors as
    `Node.write`.
    """
    clock = node.line.clock
    begun_ns = clock.now_ns()
    node.write(0x6040, 0, cia402.QUICK_STOP)
    anchor, moved_ns = node.read(0x6064), clock.now_ns()
    while clock.now_ns() - begun_ns < timeout_s * 1e9:
        state = cia402.decode_state(node.read(0x6041))
        if state not in cia402.POWERED:
            break
        counts = node.read(0x6064)
        if abs(counts - anchor) > _STILL_COUNTS:
            anchor, moved_ns = counts, clock.now_ns()
        stood_ns = clock.now_ns() - moved_ns
        if state == State.QUICK_STOP_ACTIVE and stood_ns > _SETTLE_S * 1e9:
            break
        clock.sleep_s(_POLL_S)
    node.write(0x6040, 0, cia402.DISABLE_VOLTAGE)
    return cia402.decode_state(node.read(0x6041)) not in cia402.POWERED
