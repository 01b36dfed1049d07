"""The devices of one rig: a drive and an encoder over one plant, without a bus.

Frames come in with the time the bus stamped on them, and the machine lives on that time. Only
when no SYNC has come for a while (the master died, or has not begun) does it follow `tick`.
"""

from sim_rig.canopen import drive402, encoder406
from sim_rig.canopen.cia402 import State
from sim_rig.canopen.machine import Machine
from sim_rig.canopen.node import Send, Slave
from sim_rig.canopen.objects import ObjectStore
from sim_rig.faults.catalogue import make
from sim_rig.faults.chain import Chain
from sim_rig.faults.fault import Frame, Targets
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
        self._send = send
        self._chain: Chain | None = None
        self.drive_node = Slave(
            settings.drive_node_id,
            ObjectStore(drive402.dictionary(settings.drive_node_id)),
            self._outgoing,
        )
        self.encoder_node = Slave(
            settings.encoder_node_id,
            ObjectStore(encoder406.dictionary(settings.encoder_node_id)),
            self._outgoing,
        )
        self.drive = drive402.Drive(self.drive_node, self.machine, settings)
        self.encoder = encoder406.Encoder(self.encoder_node, self.machine, settings)
        self._slaves = (self.drive_node, self.encoder_node)
        self._last_sync_us = 0
        self._now_us = 0
        if settings.faults:
            self._chain = self._faulty(settings)

    def _faulty(self, settings: RigSettings) -> Chain:
        drive = self.drive
        targets = Targets(
            drive_node=self.drive_node,
            encoder_node=self.encoder_node,
            drive=drive,
            motor_sensor=drive.sensor,
            load_sensor=self.encoder.sensor,
            second_sensor=drive.load_sensor,
        )
        faults = [
            make(line, targets, settings.seed, place) for place, line in enumerate(settings.faults)
        ]
        return Chain(faults, self._take, self._put, lambda: drive.state is State.OPERATION_ENABLED)

    def _outgoing(self, can_id: int, data: bytes) -> None:
        if self._chain is None:
            self._put(Frame(can_id, data))
        else:
            self._chain.outgoing(can_id, data)

    def _put(self, frame: Frame) -> None:
        """A frame onto the bus, and a SYNC of the drive's own to both nodes."""
        self._send(frame.can_id, frame.data)
        if frame.can_id == SYNC:
            self._deliver(SYNC, frame.data, self._now_us)

    def boot(self) -> None:
        """Send both boot-up messages."""
        for slave in self._slaves:
            slave.boot()

    def receive(self, can_id: int, data: bytes, time_us: int) -> None:
        """One frame from the bus, stamped `time_us`."""
        if can_id == SYNC and self.drive_node.produces_sync:
            return  # its own, heard again, or somebody else's: a producer follows nobody
        self._from_bus(Frame(can_id, data), time_us)

    def receive_remote(self, can_id: int, time_us: int) -> None:
        """One remote frame from the bus, stamped `time_us`."""
        self._from_bus(Frame(can_id, b"", remote=True), time_us)

    def _from_bus(self, frame: Frame, time_us: int) -> None:
        self._now_us = time_us
        if self._chain is None:
            self._take(frame, time_us)
        else:
            self._chain.receive(frame, time_us)

    def _take(self, frame: Frame, time_us: int) -> None:
        if not frame.remote:
            self._deliver(frame.can_id, frame.data, time_us)
            return
        for slave in self._slaves:
            slave.receive_remote(frame.can_id, time_us)

    def _deliver(self, can_id: int, data: bytes, time_us: int) -> None:
        if can_id == SYNC:
            self._last_sync_us = time_us
        for slave in self._slaves:
            slave.receive(can_id, data, time_us)

    def tick(self, now_us: int) -> None:
        """Do what is due by now; to be called when all frames that have come are received."""
        self._now_us = now_us
        if self._chain is not None:
            self._chain.tick(now_us)
        if self._is_quiet(now_us):
            self.machine.advance_to(now_us - LAG_US)
        for slave in self._slaves:
            slave.tick(now_us)

    def beat(self, now_us: int) -> None:
        """Send the heartbeats that are due, whatever else waits."""
        for slave in self._slaves:
            slave.beat(now_us)

    def wait_us(self, now_us: int) -> int:
        """How long from now `tick` can wait, if no frame comes."""
        moving = self._is_quiet(now_us) and self.drive.moves
        dues = [slave.due_us() for slave in self._slaves]
        if self._chain is not None:
            dues.append(self._chain.due_us())
        waits = [due - now_us for due in dues if due is not None]
        return max(0, min([*waits, MOVING_STEP_US if moving else RESTING_STEP_US]))

    def _is_quiet(self, now_us: int) -> bool:
        return now_us - self._last_sync_us > QUIET_US
