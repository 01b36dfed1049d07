"""A CiA 406 absolute encoder on the load, behind the play.

Its position 0x6004 runs through the total measuring range 0x6002 and wraps; writing the preset
0x6003 makes the present angle read as that value. The cyclic timer 0x6200 is the event timer of
TPDO1; TPDO2 answers SYNC.
"""

import canopen
import numpy as np

from sim_rig.canopen.machine import Machine
from sim_rig.canopen.node import Slave
from sim_rig.canopen.objects import Abort, load_dictionary, refuse
from sim_rig.canopen.sensor import AngleEncoder
from sim_rig.settings import RigSettings

REVOLUTIONS = 4096
_CYCLIC_TIMER = (0x6200, 0)
_EVENT_TIMER = (0x1800, 5)


def dictionary(node_id: int) -> canopen.ObjectDictionary:
    """The encoder's object dictionary."""
    return load_dictionary("sim_encoder.eds", node_id)


class Encoder:
    """The encoder behind a slave; looks at `machine`'s load angle."""

    def __init__(self, slave: Slave, machine: Machine, settings: RigSettings) -> None:
        self._machine = machine
        self._store = store = slave.store
        counts = settings.load_counts_per_revolution
        revolutions = min(REVOLUTIONS, 0xFFFFFFFF // counts)
        self._range = counts * revolutions
        self.sensor = AngleEncoder(
            counts,
            settings.load_encoder_noise_rad,
            np.random.default_rng([settings.seed, 2]),
        )
        store.set_default((0x6001, 0), counts)
        store.set_default((0x6002, 0), self._range)
        store.set_default((0x6501, 0), counts)
        store.set_default((0x6502, 0), revolutions)
        store.on_write((0x6003, 0), self._preset)
        store.on_write(_CYCLIC_TIMER, lambda period: store.__setitem__(_EVENT_TIMER, period))
        store.on_write(_EVENT_TIMER, lambda period: store.__setitem__(_CYCLIC_TIMER, period))
        self.reset()
        slave.attach(self)

    def reset(self) -> None:
        """Forget the preset."""
        self._offset = 0
        self._publish()

    def sample(self, time_us: int) -> None:
        """Let the machine reach `time_us` and read the load's angle."""
        self._machine.advance_to(time_us)
        self._publish()

    def connection_lost(self) -> None:
        """Nothing here moves."""

    def _counts(self) -> int:
        counts = self.sensor.counts(self._machine.outputs.load_angle_rad)
        return -counts if self._store[0x6000, 0] & 1 else counts

    def _preset(self, value: int) -> None:
        if value >= self._range:
            raise refuse(Abort.INVALID_VALUE)
        self._offset = value - self._counts()

    def _publish(self) -> None:
        self._store[0x6004, 0] = (self._counts() + self._offset) % self._range
