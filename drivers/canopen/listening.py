"""Is somebody else master here? Listening, before anything is sent."""

from drivers.canopen.line import Line
from drivers.canopen.node import HEARTBEAT, SYNC
from drivers.canopen.settings import CanopenSettings
from drivers.errors import WireError

_COMMAND = 0x200
LISTEN_S = 0.12
"""Longer than a heartbeat's period, and than the pause between two SYNCs at 8 ms."""


def refuse_another_master(line: Line, settings: CanopenSettings) -> None:
    """Raise WireError where SYNC, this master's own heartbeat, or a command is heard on the bus.

    Two benches on one bus would both command the drive. The cycle of the other one, or a drive
    that produces SYNC itself, is heard within `LISTEN_S`. Where the drive is to produce SYNC, a
    SYNC is no other master: a run that was killed leaves one behind.
    """
    heard: list[int] = []

    def on_frame(cob_id: int, _data: bytearray, _timestamp: float) -> None:
        heard.append(cob_id)

    master_node_id = settings.master_node_id
    command = _COMMAND + 0x100 * (settings.drive.profile.command.pdo - 1)
    command += settings.drive.node.node_id
    cob_ids = [HEARTBEAT + master_node_id, command]
    if not settings.sync_by_drive:
        cob_ids.append(SYNC)
    for cob_id in cob_ids:
        line.network.subscribe(cob_id, on_frame)
    deadline_ns = line.clock.now_ns() + round(LISTEN_S * 1e9)
    line.receive_until(deadline_ns, lambda: bool(heard))
    for cob_id in cob_ids:
        line.network.unsubscribe(cob_id, on_frame)
    if heard:
        names = {SYNC: "SYNC", command: "a command to the drive"}
        what = names.get(heard[0], f"the heartbeat of node {master_node_id}")
        raise WireError(
            f"another master is on this bus ({line.name}): {what} was heard (COB-ID "
            f"0x{heard[0]:03X}) before this bench had sent anything. Stop the other bench, or the "
            "drive that produces SYNC (bit 30 of 0x1005), or follow it (drive.sync). Nothing was "
            "sent."
        )
