"""The software rig and the bench in one thread, on a clock of their own: no socket, no sleep.

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
from drivers.clock import Clock as DriversClock
from servo_bench.clock import Clock
from sim_rig.canopen import drive402, encoder406
from sim_rig.canopen.cia402 import POWERED
from sim_rig.canopen.objects import load_dictionary
from sim_rig.canopen.rig import Rig
from sim_rig.settings import RigSettings
from tests.coasting_plant import CoastingPlant
from tests.wire import SETTINGS

EDS = Path(sim_rig.__file__).parent / "eds"
EPOCH_US = 1_700_000_000_000_000
WORLDS: dict[str, "VirtualRig"] = {}


class VirtualRig:
    """A rig with faults, its bus, and its time."""

    def __init__(self, name: str, **changes: Any) -> None:
        self.name = name
        self.settings: RigSettings = replace(SETTINGS, **changes)
        self.now_ns = 1_000_000_000
        self.waiting: deque[can.Message] = deque()
        self.closed = 0
        self.sent: list[tuple[int, bytes]] = []
        self.rig = Rig(self.settings, CoastingPlant(self.settings.nominal), self._heard)
        self.rig.boot()
        self.waiting.clear()
        WORLDS[name] = self

    @property
    def now_us(self) -> int:
        return EPOCH_US + self.now_ns // 1000

    def _heard(self, can_id: int, data: bytes) -> None:
        self.waiting.append(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def look_at_clock(self) -> int:
        self.now_ns += 1000
        return self.now_ns

    def pass_until(self, end_ns: int, *, stop_on_frame: bool = False) -> None:
        """Let time pass, the rig doing what is due, until then or until a frame has come."""
        while self.now_ns < end_ns and not (stop_on_frame and self.waiting):
            step_ns = max(1000, self.rig.wait_us(self.now_us) * 1000)
            self.now_ns = min(self.now_ns + step_ns, end_ns)
            self.rig.tick(self.now_us)

    def receive(self, timeout_s: float) -> can.Message | None:
        self.pass_until(self.now_ns + round(timeout_s * 1e9), stop_on_frame=True)
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
        clock = DriversClock(self.look_at_clock, self._sleep)
        return CanopenAxis(settings or self.canopen_settings(), clock)

    def _sleep(self, duration_s: float) -> None:
        self.pass_until(self.now_ns + round(duration_s * 1e9))


class RunClock(Clock):
    """The run's clock on a rig's time; `holes_ns` are wake-ups that come late."""

    def __init__(self, world: VirtualRig) -> None:
        self._world = world

    def now_ns(self) -> int:
        return self._world.look_at_clock()

    def sleep_until(self, deadline_ns: int) -> int:
        self._world.pass_until(deadline_ns)
        return self._world.look_at_clock()


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
