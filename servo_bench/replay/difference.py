"""Run against run: what differs, by how much, and when. Slots are laid upon slots.

Angles are compared as velocities over one slot, so that where a run began does not count, and
neither does what both runs lack. `floor` is the rms at standstill of both runs together: below it
a difference is the sensors'.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import RecordingError
from servo_bench.excitation.experiment import Phase
from servo_bench.kernels.response import slot_numbers
from servo_bench.recording.recording import Recording
from servo_bench.replay.change import finite

Array = NDArray[np.float64]

SIGNALS = (
    ("command", "velocity_command_rad_s", "rad/s", False),
    ("motor velocity", "motor_position_rad", "rad/s", True),
    ("load velocity", "load_angle_rad", "rad/s", True),
    ("torque", "motor_torque_nm", "N m", False),
)
"""Name, channel, unit, and whether increments over a slot are compared."""
PIECES = 10


@dataclass(frozen=True, slots=True)
class SignalDifference:
    """One signal, b less a. `share_percent` is the rms of the difference over that of a.

    `largest` is the greatest difference and `largest_slot`, `largest_s` where it is; `pieces` the
    rms in each tenth of the run.
    """

    name: str
    unit: str
    rms: float
    rms_a: float
    floor: float
    largest: float
    largest_slot: int
    largest_s: float
    phases: dict[str, float]
    pieces: tuple[float, ...]

    @property
    def share_percent(self) -> float:
        """Percent of a; NaN where a is still."""
        return 100.0 * self.rms / self.rms_a if self.rms_a else math.nan

    @property
    def sentence(self) -> str:
        """The difference in words."""
        share = f" ({self.share_percent:.2g} %)" if math.isfinite(self.share_percent) else ""
        floor = f", of which the sensors explain {self.floor:.2g}" if self.floor else ""
        return (
            f"{self.name}: {self.rms:.3g} {self.unit} rms{share}{floor}; at most "
            f"{abs(self.largest):.3g} {self.unit}, in slot {self.largest_slot} "
            f"({self.largest_s:.3f} s)."
        )

    def numbers(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "unit": self.unit,
            "rms": self.rms,
            "rms_a": self.rms_a,
            "share_percent": finite(self.share_percent),
            "floor": self.floor,
            "largest": self.largest,
            "largest_slot": self.largest_slot,
            "largest_s": self.largest_s,
            "phases": self.phases,
            "pieces": list(self.pieces),
        }


@dataclass(frozen=True, slots=True)
class RunDifference:
    """All signals that both runs have, over the `slots` that both played."""

    slots: int
    signals: tuple[SignalDifference, ...]

    def numbers(self) -> dict[str, Any]:
        """As plain values, ready for JSON."""
        return {
            "slots": self.slots,
            "signals": {signal.name: signal.numbers() for signal in self.signals},
        }


def difference(a: Recording, b: Recording, *, first_slot: int | None = None) -> RunDifference:
    """b less a, slot by slot from the first of each, or from slot `first_slot` of b.

    RecordingError where they share fewer than two slots, or no signal.
    """
    of_b = _slots(b) if first_slot is None else slot_numbers(b) - first_slot
    slots, rows_a, rows_b = np.intersect1d(_slots(a), of_b, return_indices=True)
    if slots.size < 2:
        raise RecordingError(f"the two runs share {slots.size} slots: there is nothing to compare.")
    signals = tuple(_signals(a, b, slots, rows_a, rows_b))
    if not signals:
        raise RecordingError("the two runs share no signal: record the same channels in both.")
    return RunDifference(int(slots.size), signals)


def _slots(recording: Recording) -> NDArray[np.int64]:
    """Counted from the first; of rows in one slot the first is taken."""
    slots = slot_numbers(recording)
    counted: NDArray[np.int64] = slots - slots[0] if slots.size else slots
    return counted


def _signals(
    a: Recording,
    b: Recording,
    slots: NDArray[np.int64],
    rows_a: NDArray[np.intp],
    rows_b: NDArray[np.intp],
) -> Iterator[SignalDifference]:
    phase = a["phase"][rows_a] if "phase" in a else np.full(slots.size, Phase.IDENTIFICATION)
    for name, channel, unit, increments in SIGNALS:
        if channel not in a or channel not in b:
            continue
        one, other = (
            _values(run[channel][rows], slots, run.period_s, increments=increments)
            for run, rows in ((a, rows_a), (b, rows_b))
        )
        known = np.isfinite(one) & np.isfinite(other)
        if known.any():
            place = _Place(phase, slots, a.period_s)
            yield _one(name, unit, np.where(known, one, np.nan), other, place)


def _values(
    values: NDArray[Any], slots: NDArray[np.int64], period_s: float, *, increments: bool
) -> Array:
    shown = values.astype(np.float64)
    if not increments:
        return shown
    steps = np.diff(shown, append=np.nan) / period_s
    return np.where(np.diff(slots, append=slots[-1]) == 1, steps, np.nan)


class _Place(NamedTuple):
    """Where each compared row is; arrays of shape (slots,)."""

    phase: NDArray[Any]
    slots: NDArray[np.int64]
    period_s: float


def _one(name: str, unit: str, a: Array, b: Array, where: _Place) -> SignalDifference:
    off, phase = b - a, where.phase
    place = int(np.nanargmax(np.abs(off)))
    still = phase == Phase.STANDSTILL
    return SignalDifference(
        name=name,
        unit=unit,
        rms=_rms(off),
        rms_a=_rms(a),
        floor=_rms(off[still]),
        largest=float(off[place]),
        largest_slot=int(where.slots[place]),
        largest_s=float(where.slots[place] * where.period_s),
        phases={p.name.lower(): _rms(off[phase == p]) for p in Phase if (phase == p).any()},
        pieces=tuple(_rms(piece) for piece in np.array_split(off, PIECES)),
    )


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return math.sqrt(float(np.mean(known**2))) if known.size else 0.0
