"""The rig's own model, telling a file how fast its motor really turns, whatever the wire says.

    plant = "tests.watched_plant:watched", environment WATCHED_PLANT = a file

The file holds: when the plant was last advanced (CLOCK_MONOTONIC, ns), when it last moved, its
motor's velocity (rad/s), and whether the power was on.
"""

import mmap
import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from servo_bench.clock import monotonic_ns
from sim_rig.model import Model
from sim_rig.plant import PlantOutputs
from sim_rig.settings import Nominal

PLANT = "tests.watched_plant:watched"
FILE = "WATCHED_PLANT"
MOVES_RAD_S = 0.05
_STATE = struct.Struct("<qqd?")


class WatchedPlant:
    """As the model; every advance is told."""

    def __init__(self, nominal: Nominal, memory: mmap.mmap) -> None:
        self._plant = Model(nominal).plant()
        self._memory = memory
        self._moved_ns = 0

    def advance(self, velocity_command_rad_s: float | None, duration_s: float) -> None:
        """As the model."""
        self._plant.advance(velocity_command_rad_s, duration_s)
        now_ns, velocity_rad_s = monotonic_ns(), self._plant.outputs().motor_velocity_rad_s
        if abs(velocity_rad_s) > MOVES_RAD_S:
            self._moved_ns = now_ns
        powered = velocity_command_rad_s is not None
        # packed first: in place every byte is zero for a moment, which reads as standing still
        self._memory[:] = _STATE.pack(now_ns, self._moved_ns, velocity_rad_s, powered)

    def outputs(self) -> PlantOutputs:
        """As the model."""
        return self._plant.outputs()


def watched(nominal: Nominal, _seed: int) -> WatchedPlant:
    """The factory."""
    return WatchedPlant(nominal, _mapped(Path(os.environ[FILE])))


def _mapped(path: Path) -> mmap.mmap:
    with path.open("r+b") as file:
        return mmap.mmap(file.fileno(), _STATE.size)


@dataclass(frozen=True, slots=True)
class Motion:
    """What the plant has told."""

    told_ns: int
    moved_ns: int
    velocity_rad_s: float
    powered: bool

    @property
    def stands(self) -> bool:
        """Power off, and no velocity."""
        return not self.powered and abs(self.velocity_rad_s) <= MOVES_RAD_S


class Witness:
    """The other end of the file."""

    def __init__(self, path: Path) -> None:
        path.write_bytes(bytes(_STATE.size))
        self._memory = _mapped(path)

    def look(self) -> Motion:
        """The plant as it is now."""
        return Motion(*_STATE.unpack_from(self._memory))

    def close(self) -> None:
        """Let go of the file."""
        self._memory.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
