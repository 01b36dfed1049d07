"""A CiA 402 drive on durand, an independent CANopen responder: its CiA 301 is not ours.

Only the power state machine and an ideal motor are written here; SDO, NMT, PDO mapping, SYNC,
heartbeat, emergency, and the EDS are durand's own.
"""

import threading
import time
from pathlib import Path

import can
import durand
from durand.datatypes import DatatypeEnum as Type
from durand.object_dictionary import Record, Variable
from durand.scheduler import SyncScheduler, set_scheduler

COUNTS = 4096
_NEXT = {0x40: {0x06: 0x21}, 0x21: {0x07: 0x23, 0x0F: 0x27}, 0x23: {0x0F: 0x27, 0x06: 0x21}}


class DurandDrive:
    """The drive on a bus of its own; `close` ends its threads."""

    def __init__(self, channel: str, node_id: int = 1) -> None:
        self._scheduler = SyncScheduler()
        set_scheduler(self._scheduler)
        self._timers = threading.Thread(target=self._scheduler.run, daemon=True)
        self.bus = can.Bus(channel, interface="virtual")
        self._network = durand.CANBusNetwork(self.bus)
        self.node = durand.MinimalNode(self._network, node_id)
        self.node.sync.callbacks.add(self._sample)  # before any PDO asks for it
        self._fill()
        self._state, self._position, self._sampled_s = 0x40, 0.0, time.monotonic()
        self._timers.start()

    def close(self) -> None:
        self.node.object_dictionary.write(0x1017, 0, 0)
        self._scheduler.stop()
        self._network.stop()
        self._timers.join(5.0)
        self.bus.shutdown()

    def eds(self, path: Path) -> Path:
        """The EDS that durand writes of itself."""
        path.write_text(self.node.eds.content)
        return path

    @property
    def enabled(self) -> bool:
        return self._state == 0x27

    def trip(self, code: int) -> None:
        """Fall into fault."""
        self._state = 0x08
        self._publish()
        self.node.emcy.set(code, 1)

    def _fill(self) -> None:
        dictionary = self.node.object_dictionary
        for index, kind, access, value in (
            (0x603F, Type.UNSIGNED16, "ro", 0),
            (0x6040, Type.UNSIGNED16, "rw", 0),
            (0x6041, Type.UNSIGNED16, "ro", 0x0250),
            (0x605A, Type.INTEGER16, "rw", 2),
            (0x6060, Type.INTEGER8, "rw", 0),
            (0x6061, Type.INTEGER8, "ro", 0),
            (0x6064, Type.INTEGER32, "ro", 0),
            (0x606C, Type.INTEGER32, "ro", 0),
            (0x60A9, Type.UNSIGNED32, "rw", 0x00B50300),
            (0x60FF, Type.INTEGER32, "rw", 0),
            (0x6502, Type.UNSIGNED32, "ro", 1 << 8),
        ):
            dictionary[index] = Variable(kind, access, value, name=f"Object {index:04X}")
        resolution = Record(name="Position encoder resolution")
        resolution[1] = Variable(Type.UNSIGNED32, "rw", COUNTS, name="Increments")
        resolution[2] = Variable(Type.UNSIGNED32, "rw", 1, name="Revolutions")
        dictionary[0x608F] = resolution
        dictionary.update_callbacks[(0x6040, 0)].add(self._control)
        dictionary.update_callbacks[(0x6060, 0)].add(lambda mode: dictionary.write(0x6061, 0, mode))

    def _control(self, word: int) -> None:
        if self._state == 0x08:
            self._state = 0x40 if word & 0x80 else 0x08
        elif word & 0x02 == 0 or word & 0x07 == 0x02:
            self._state = 0x40
        else:
            self._state = _NEXT.get(self._state, {}).get(word & 0x0F, self._state)
        self._publish()

    def _publish(self) -> None:
        follows = 0x1000 if self.enabled else 0
        self.node.object_dictionary.write(0x6041, 0, 0x0210 | self._state | follows)

    def _sample(self) -> None:
        dictionary = self.node.object_dictionary
        now_s = time.monotonic()
        velocity = dictionary.read(0x60FF, 0) if self.enabled else 0
        self._position += velocity * (now_s - self._sampled_s)
        self._sampled_s = now_s
        dictionary.write(0x6064, 0, round(self._position))
        dictionary.write(0x606C, 0, velocity)
