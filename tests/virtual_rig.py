"""The software rig on CANopen in virtual time, and what makes python-can know its bus.

The slaves, their faults, and the bus's time are the real ones of `sim_rig`; the master is the real
one of `drivers`. A frame that the master sends is taken by the rig before `send` returns; time
passes only while the master waits. A second of the rig takes some milliseconds.
"""

import logging
from collections import deque
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import can
from can.interfaces import BACKENDS

import drivers.canopen.setup
import sim_rig
from drivers.canopen.eds import load_eds
from drivers.canopen.master import CanopenAxis
from drivers.canopen.settings import (
    CanopenSettings,
    DriveSettings,
    EncoderSettings,
    NodeSettings,
)
from sim_rig.canopen import drive402, encoder406
from sim_rig.canopen.cia402 import POWERED
from sim_rig.canopen.objects import load_dictionary
from sim_rig.canopen.rig import Rig
from sim_rig.settings import RigSettings
from tests.coasting_plant import CoastingPlant
from tests.virtual_world import VirtualWorld
from tests.wire import SETTINGS

EDS = Path(sim_rig.__file__).parent / "eds"
EPOCH_US = 1_700_000_000_000_000
WORLDS: dict[str, "VirtualRig"] = {}


class VirtualRig(VirtualWorld):
    """A rig with faults, its bus, and its time."""

    def __init__(self, name: str, **changes: Any) -> None:
        super().__init__()
        self.name = name
        self.settings: RigSettings = replace(SETTINGS, **changes)
        self.waiting: deque[can.Message] = deque()
        self.closed = 0
        self.sent: list[tuple[int, bytes]] = []
        faults = replace(self.settings, faults=self.settings.wire_faults)
        self.rig = Rig(faults, CoastingPlant(self.settings.nominal), self._heard)
        self.rig.boot()
        self.waiting.clear()
        WORLDS[name] = self

    @property
    def now_us(self) -> int:
        return EPOCH_US + self.now_ns // 1000

    def _heard(self, can_id: int, data: bytes) -> None:
        self.waiting.append(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def rig_wait_us(self) -> int:
        return self.rig.wait_us(self.now_us)

    def rig_tick(self) -> None:
        self.rig.tick(self.now_us)

    def receive(self, timeout_s: float) -> can.Message | None:
        if not self.waiting:
            self.pass_until(self.now_ns + round(timeout_s * 1e9), self.waiting.__len__)
        return self.waiting.popleft() if self.waiting else None

    def take(self, can_id: int, data: bytes) -> None:
        self.sent.append((can_id, data))
        self.rig.receive(can_id, data, self.now_us)

    @property
    def powered(self) -> bool:
        """Whether the drive really holds the motor, whatever it says."""
        return self.rig.drive.state in POWERED

    @property
    def velocity_rad_s(self) -> float:
        """The motor's true velocity."""
        return self.rig.machine.outputs.motor_velocity_rad_s

    def load_counts(self, time_us: int) -> int:
        """The load encoder's count at a time of the run's clock, for a device beside the bus."""
        self.rig.machine.advance_to(EPOCH_US + time_us)
        return self.rig.encoder.sensor.counts(self.rig.machine.outputs.load_angle_rad)

    def canopen_settings(self, period_s: float = 0.008, **changes: Any) -> CanopenSettings:
        """What the master must know of this rig; `changes` are fields of DriveSettings."""
        drive = DriveSettings(NodeSettings(1, EDS / "sim_drive.eds", 0, 402), 65536)
        return CanopenSettings(
            bus={"interface": "virtual-rig", "channel": self.name},
            drive=replace(drive, **changes),
            encoder=EncoderSettings(NodeSettings(2, EDS / "sim_encoder.eds", 0, 406), 65536),
            period_s=period_s,
        )

    def axis(self, settings: CanopenSettings | None = None) -> CanopenAxis:
        """A master for this rig."""
        return CanopenAxis(settings or self.canopen_settings(), self.clock())


class VirtualBus(can.BusABC):
    """python-can's side of a `VirtualRig`; registered as interface "virtual-rig"."""

    def __init__(self, channel: str) -> None:
        self._world = WORLDS[channel]
        self.channel_info = f"virtual rig {channel}"
        super().__init__(channel)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if msg.is_remote_frame:
            self._world.rig.receive_remote(msg.arbitration_id, self._world.now_us)
        else:
            self._world.take(msg.arbitration_id, bytes(msg.data))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        assert timeout is not None, "the master must never wait without end"
        return self._world.receive(timeout)

    def shutdown(self) -> None:
        self._world.closed += 1
        super().shutdown()


def install() -> None:
    """Make python-can know the interface, and read each EDS only once: thousands of runs follow."""
    BACKENDS["virtual-rig"] = (__name__, VirtualBus.__name__)
    logging.getLogger("canopen").disabled = True
    drivers.canopen.setup.load_eds = cache(load_eds)
    for module in (drive402, encoder406):
        module.load_dictionary = cache(load_dictionary)
