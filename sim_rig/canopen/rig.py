"""The devices of one rig: a drive and an encoder over one plant, without a bus.

Frames come in with the time the bus stamped on them, and the machine lives on that time. Only
when no SYNC has come for a while (the master died, or has not begun) does it follow `tick`.
"""

from sim_rig.canopen import drive402, encoder406
from sim_rig.canopen.machine import Machine
from sim_rig.canopen.node import Send, Slave
from sim_rig.canopen.objects import ObjectStore
from sim_rig.plant import Plant
from sim_rig.settings import RigSettings

SYNC = 0x80

QUIET_US = 50_000
"""Without a SYNC for so long, the machine moves on by itself."""
LAG_US = 1_000
"""How far it then stays behind the clock, so that no frame under way finds its time past."""
MOVING_STEP_US = 4_000
RESTING_STEP_US = 50_000


class Rig:
    """Both slaves and what they move. `send(identifier, data)` puts a frame on the bus."""

    def __init__(self, settings: RigSettings, plant: Plant, send: Send) -> None:
        self.machine = Machine(plant)
        self.drive_node = Slave(
            settings.drive_node_id,
            ObjectStore(drive402.dictionary(settings.drive_node_id)),
            send,
        )
        self.encoder_node = Slave(
            settings.encoder_node_id,
            ObjectStore(encoder406.dictionary(settings.encoder_node_id)),
            send,
        )
        self.drive = drive402.Drive(self.drive_node, self.machine, settings)
        self.encoder = encoder406.Encoder(self.encoder_node, self.machine, settings)
        self._slaves = (self.drive_node, self.encoder_node)
        self._last_sync_us = 0

    def boot(self) -> None:
        """Send both boot-up messages."""
        for slave in self._slaves:
            slave.boot()

    def receive(self, can_id: int, data: bytes, time_us: int) -> None:
        """One frame from the bus, stamped `time_us`."""
        if can_id == SYNC:
            self._last_sync_us = time_us
        for slave in self._slaves:
            slave.receive(can_id, data, time_us)

    def tick(self, now_us: int) -> None:
        """Do what is due by now; to be called when all frames that have come are received."""
        if self._is_quiet(now_us):
            self.machine.advance_to(now_us - LAG_US)
        for slave in self._slaves:
            slave.tick(now_us)

    def wait_us(self, now_us: int) -> int:
        """How long from now `tick` can wait, if no frame comes."""
        moving = self._is_quiet(now_us) and self.drive.moves
        dues = (slave.due_us() for slave in self._slaves)
        waits = [due - now_us for due in dues if due is not None]
        return max(0, min([*waits, MOVING_STEP_US if moving else RESTING_STEP_US]))

    def _is_quiet(self, now_us: int) -> bool:
        return now_us - self._last_sync_us > QUIET_US
