"""A rig on a bus that never pauses, or on a computer that is too slow for it."""

from collections.abc import Iterator
from itertools import count, pairwise

import can

from sim_rig.canopen.busloop import RigOnBus
from sim_rig.model import Model
from tests.wire import NOMINAL, SETTINGS

PERIOD_S, HEARTBEAT_S = 1e-3, 0.05
DRIVE_HEARTBEAT = 0x700 + 1


class NeverQuiet(can.BusABC):
    """A bus on which the next SYNC has always come already."""

    def __init__(self) -> None:
        self.sent: list[tuple[float, int]] = []
        self.time_s = 1000.0
        self._frames = self._syncs()
        super().__init__("never quiet")

    def _syncs(self) -> Iterator[can.Message]:
        for slot in count():
            self.time_s = 1000.0 + slot * PERIOD_S
            yield can.Message(arbitration_id=0x80, is_extended_id=False, timestamp=self.time_s)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message, bool]:
        return next(self._frames), False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.sent.append((self.time_s, msg.arbitration_id))


def test_a_rig_that_has_always_more_to_do_says_that_it_lives() -> None:
    bus = NeverQuiet()
    loop = RigOnBus(SETTINGS, Model(NOMINAL).plant(), bus)
    loop.rig.drive_node.store.set_data(0x1017, 0, round(1e3 * HEARTBEAT_S).to_bytes(2, "little"))
    loop.rig.boot()
    while bus.time_s < 1002.0:
        loop.step()
    beats_s = [at_s for at_s, cob_id in bus.sent if cob_id == DRIVE_HEARTBEAT and at_s > 1000.0]
    gaps_s = [b - a for a, b in pairwise(beats_s)]
    bus.shutdown()
    assert len(beats_s) > 10
    assert max(gaps_s) < 3 * HEARTBEAT_S
