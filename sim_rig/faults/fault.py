"""What a fault is: a filter on frames, and something that may act at a SYNC.

Time is counted in SYNCs since the drive was enabled, because a count repeats exactly on every
machine; a fault with `at` below 0 is there from power-on.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

Values = dict[str, int | float | str]
"""What a fault was given, complete: every name of its kind with a value."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame on its way, and how long it is held up; a `remote` one only asks."""

    can_id: int
    data: bytes
    delay_us: int = 0
    remote: bool = False

    def later(self, delay_us: int) -> "Frame":
        """The same frame, held up for so much longer."""
        return replace(self, delay_us=self.delay_us + delay_us)


class NodeTarget(Protocol):
    """What a fault may do to a node."""

    @property
    def node_id(self) -> int: ...

    def power_cycle(self, time_us: int) -> None:
        """Lose power and come back: everything forgotten, a boot-up frame."""
        ...

    def emergency(self, code: int, register: int) -> None:
        """Send an emergency."""
        ...


class DriveTarget(Protocol):
    """What a fault may do to the drive behind its node."""

    status_filter: Callable[[int], int] | None

    def trip(self, code: int) -> None:
        """Fall into fault, with an emergency."""
        ...

    def let_go(self) -> None:
        """Lose the power stage."""
        ...


class SensorTarget(Protocol):
    """What a fault may do to an encoder's counts."""

    distortion: Callable[[int], int] | None


@dataclass(frozen=True, slots=True)
class Targets:
    """The rig as faults see it."""

    drive_node: NodeTarget
    encoder_node: NodeTarget
    drive: DriveTarget
    motor_sensor: SensorTarget
    load_sensor: SensorTarget
    second_sensor: SensorTarget

    def node(self, name: str) -> NodeTarget:
        """The node called drive or encoder."""
        return self.drive_node if name == "drive" else self.encoder_node

    def sensor(self, name: str) -> SensorTarget:
        """The encoder called motor, load (the node's), or second (the drive's, 0x60E4)."""
        if name == "second":
            return self.second_sensor
        return self.motor_sensor if name == "motor" else self.load_sensor


class Fault:
    """A fault that does nothing: the base of the others. `now_us` is the bus's time."""

    def __init__(self, values: Values, targets: Targets, seed: list[int]) -> None:
        self.values = values
        self.targets = targets
        self.now_us = 0
        self._seed = seed
        self.at = int(values.get("at", 0))
        self.rearm()

    def rearm(self) -> None:
        """A run begins, or has ended: as if nothing had happened yet."""
        self.random = np.random.default_rng(self._seed)
        self.syncs = -1

    def on_sync(self, count: int) -> None:
        """SYNC number `count` since the drive was enabled is about to reach the nodes."""
        self.syncs = count
        if count == self.at:
            self.begin()

    def begin(self) -> None:
        """SYNC number `at` has come."""

    @property
    def active(self) -> bool:
        """Whether its time has come."""
        return self.syncs >= self.at

    def incoming(self, frame: Frame) -> list[Frame]:
        """What the nodes get of a frame from the bus."""
        return [frame]

    def outgoing(self, frame: Frame) -> list[Frame]:
        """What the bus gets of a frame from a node."""
        return [frame]
