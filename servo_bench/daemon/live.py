"""What a browser sees while something plays: blocks of rows as binary frames.

A frame is little-endian: four uint32 (magic 0x53424C56, rows n, columns 6, 0), then n x 6 float64:

    t_s  velocity_command_rad_s  motor_velocity_rad_s  load_angle_rad  motor_current_a  lateness_s

Each viewer has a cursor into the rows and nothing else: one that is slow gets fewer of them, evenly
thinned, and costs the daemon no memory.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from servo_bench.clock import NS_PER_S, monotonic_ns
from servo_bench.recording.recording import MISSING, Recording
from servo_bench.run.table import UNPLAYED, SlotTable

MAGIC = 0x53424C56
COLUMNS = (
    "t_s",
    "velocity_command_rad_s",
    "motor_velocity_rad_s",
    "load_angle_rad",
    "motor_current_a",
    "lateness_s",
)
MAX_ROWS = 500
"""In one frame: half a second at 1 kHz. Beyond it rows are thinned."""
LINGER_S = 1.0
"""How long a replay that has come to its end can still be seen: pages fetch its last rows."""
_HEAD = struct.Struct("<4I")
Rows = NDArray[np.float64]


class Source(Protocol):
    """Rows that become more while time passes."""

    def ready(self) -> int:
        """How many rows there are by now."""
        ...

    def rows(self, begin: int, end: int) -> Rows:
        """Rows `begin` to `end` in COLUMNS, shape (at most end - begin, 6)."""
        ...


@dataclass(frozen=True, slots=True)
class TableSource:
    """The rows of a run that plays now, from the memory that the bus loop fills."""

    table: SlotTable
    torque_constant_nm_per_a: float

    def ready(self) -> int:
        """Slots that are settled."""
        return self.table.done

    def rows(self, begin: int, end: int) -> Rows:
        """Copies; slots that were skipped are left out."""
        block = self.table.rows[begin:end]
        block = block[block["slot"] != UNPLAYED]
        start_ns = int(self.table.rows["asked_ns"][0])
        if start_ns == MISSING:  # the first slot itself was skipped
            start_ns = int(block["asked_ns"][0]) if block.size else 0
        return np.column_stack(
            [
                (block["asked_ns"] - start_ns) / NS_PER_S,
                block["velocity_command_rad_s"],
                block["motor_velocity_rad_s"],
                block["load_angle_rad"],
                _current_a(
                    block["motor_current_a"],
                    block["motor_torque_nm"],
                    self.torque_constant_nm_per_a,
                ),
                block["lateness_s"],
            ]
        )


class ReplaySource:
    """A recording played again at `speed`, from `start_s` on."""

    def __init__(
        self,
        recording: Recording,
        speed: float,
        start_s: float = 0.0,
        now_ns: Callable[[], int] = monotonic_ns,
    ) -> None:
        self._columns = _columns(recording)
        self._speed = speed
        self._start_s = start_s
        self._now_ns = now_ns
        self._begun_ns = now_ns()

    @property
    def over(self) -> bool:
        """Whether its last row has been played, and every page has had time to show it."""
        return self._played(LINGER_S) >= len(self._columns)

    def ready(self) -> int:
        """Rows whose time has come."""
        return self._played(0.0)

    def _played(self, ago_s: float) -> int:
        elapsed_s = (self._now_ns() - self._begun_ns) / NS_PER_S - ago_s
        return int(np.searchsorted(self._columns[:, 0], self._start_s + elapsed_s * self._speed))

    def rows(self, begin: int, end: int) -> Rows:
        """As they were recorded."""
        return self._columns[begin:end]


def _current_a(
    current_a: NDArray[np.float64], torque_nm: NDArray[np.float64], torque_constant: float
) -> NDArray[np.float64]:
    """The drive's own current; where it tells none, what its torque takes nominally."""
    known: NDArray[np.float64] = np.where(
        np.isfinite(current_a), current_a, torque_nm / torque_constant
    )
    return known


def _columns(recording: Recording) -> Rows:
    count = len(recording)

    def channel(name: str) -> NDArray[np.float64]:
        return recording[name].astype(np.float64) if name in recording else np.full(count, np.nan)

    if "slot" in recording:
        slots = recording["slot"]
        time_s = (slots - (slots[0] if count else 0)) * recording.period_s
    else:
        time_s = recording["t_s"] - (recording["t_s"][0] if count else 0.0)
    current_a = channel("motor_current_a")
    if recording.rig is not None:
        torque_constant = recording.rig.nominal.torque_constant_nm_per_a
        current_a = _current_a(current_a, channel("motor_torque_nm"), torque_constant)
    return np.column_stack(
        [
            time_s,
            channel("velocity_command_rad_s"),
            channel("motor_velocity_rad_s"),
            channel("load_angle_rad"),
            current_a,
            channel("lateness_s"),
        ]
    )


class Viewer:
    """One viewer's place in a source."""

    def __init__(self) -> None:
        self._source: Source | None = None
        self._cursor = 0

    def frame(self, source: Source | None, history: int = 0) -> bytes | None:
        """What is new since the last call, None where nothing is.

        A viewer that comes to a source begins `history` rows before its end.
        """
        if source is None:
            self._source = None
            return None
        ready = source.ready()
        if source is not self._source:
            self._source, self._cursor = source, max(0, ready - history)
        if ready <= self._cursor:
            return None
        rows = source.rows(self._cursor, ready)
        self._cursor = ready
        return frame(thinned(rows)) if len(rows) else None


def thinned(rows: Rows) -> Rows:
    """At most MAX_ROWS of the rows, evenly, the last always among them."""
    if len(rows) <= MAX_ROWS:
        return rows
    kept = np.linspace(0, len(rows) - 1, MAX_ROWS).astype(np.intp)
    return rows[kept]


def frame(rows: Rows) -> bytes:
    """Rows of shape (n, 6) as one binary frame."""
    return _HEAD.pack(MAGIC, len(rows), len(COLUMNS), 0) + rows.astype("<f8").tobytes()
