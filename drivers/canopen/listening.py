"""Is somebody else master here? Listening, before anything is sent."""

from drivers.canopen.line import Line
from drivers.canopen.node import HEARTBEAT, SYNC
from drivers.errors import WireError

LISTEN_S = 0.12
"""Longer than a heartbeat's period, and than the pause between two SYNCs at 8 ms."""


def refuse_another_master(line: Line, master_node_id: int) -> None:
    """Raise WireError where SYNC or this master's own heartbeat is heard on the bus.

    Two benches on one bus would both command the drive. The cycle of the other one, or a drive
    that produces SYNC itself, is heard within `LISTEN_S`.
    """
    heard: list[int] = []

    def on_frame(cob_id: int, _data: bytearray, _timestamp: float) -> None:
        heard.append(cob_id)

    cob_ids = (SYNC, HEARTBEAT + master_node_id)
    for cob_id in cob_ids:
        line.network.subscribe(cob_id, on_frame)
    deadline_ns = line.clock.now_ns() + round(LISTEN_S * 1e9)
    line.receive_until(deadline_ns, lambda: bool(heard))
    for cob_id in cob_ids:
        line.network.unsubscribe(cob_id, on_frame)
    if heard:
        what = "SYNC" if heard[0] == SYNC else f"the heartbeat of node {master_node_id}"
        raise WireError(
            f"another master is on this bus ({line.name}): {what} was heard (COB-ID "
            f"0x{heard[0]:03X}) before this bench had sent anything. Stop the other bench, or the "
            "drive that produces SYNC (bit 30 of 0x1005). Nothing was sent."
        )
