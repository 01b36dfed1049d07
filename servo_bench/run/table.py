"""The table that the bus loop fills and the session reads: shared memory, no locks, no calls.

One row of SAMPLE_DTYPE for every slot of the schedule, allocated before the run, one of FAST_DTYPE
for each of a slot's samples where it has several, and a few words beside them. Every word is an
aligned 64-bit integer, which x86-64 and AArch64 store whole, and has one writer:

    loop         rows, fast, done (stored after the rows it covers), slot, missed, stage, beat_ns,
                 temperature_mc (thousandths of a degree)
    session      stop
    supervisor   watch_ns, and the trip: kind and text first, trip_ns after them
"""

import mmap
import os
from dataclasses import dataclass
from enum import IntEnum
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from servo_bench.recording.recording import (
    FAST_DTYPE,
    FAST_FIELDS,
    MISSING,
    SAMPLE_DTYPE,
    SAMPLE_FIELDS,
)

UNPLAYED = -1
"""The `slot` of a row whose slot was skipped or is still to come."""

_NUMBERS = (
    *("done", "slot", "missed", "stage", "beat_ns", "temperature_mc"),
    *("stop", "watch_ns", "trip_ns"),
)
_TRIP_TEXT_BYTES = 1000
_WORDS = np.dtype(
    [(name, "<i8") for name in _NUMBERS]
    + [("trip_kind", "S24"), ("trip_text", f"S{_TRIP_TEXT_BYTES}")]
)


def _empty(fields: tuple[tuple[str, str], ...], dtype: "np.dtype[np.void]") -> NDArray[np.void]:
    row = np.zeros((), dtype)
    for name, kind in fields:
        if kind == "float64":
            row[name] = np.nan
        elif kind == "int64":
            row[name] = MISSING
    row["slot"] = UNPLAYED
    return row


class Stage(IntEnum):
    """Where the bus loop is: power may be on from ENABLING to STOPPING, and after the loop where
    it left UNCONFIRMED. RESTING is between PLAYING and STOPPING: no slot is played any more."""

    STARTING = 0
    ENABLING = 1
    PLAYING = 2
    STOPPING = 3
    OVER = 4
    UNCONFIRMED = 5
    RESTING = 6


@dataclass(frozen=True, slots=True)
class Trip:
    """Why the supervisor stopped the rig: `kind` as in `servo_bench.run.judge.KINDS`."""

    kind: str
    text: str


class SlotTable:
    """Rows and words in memory that two processes share; closing it frees this side's view.

    The memory has no name, only a descriptor that the session hands to the loop: it vanishes with
    the last process that holds it, however that one ends.
    """

    def __init__(self, descriptor: int, slots: int, samples_per_slot: int = 1) -> None:
        """Look at that memory; who leaves `samples_per_slot` out does without the fast rows."""
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, _size(slots, samples_per_slot))
        self._words: NDArray[np.void] | None = np.ndarray((), _WORDS, self._memory)
        self._rows: NDArray[np.void] | None = np.ndarray(
            (slots,), SAMPLE_DTYPE, self._memory, offset=_WORDS.itemsize
        )
        self._fast: NDArray[np.void] | None = np.ndarray(
            (_fast_rows(slots, samples_per_slot),), FAST_DTYPE, self._memory, offset=_size(slots, 1)
        )

    @classmethod
    def create(cls, slots: int, samples_per_slot: int = 1) -> Self:
        """A table of empty rows."""
        descriptor = os.memfd_create("servo-bench-slots")
        os.ftruncate(descriptor, _size(slots, samples_per_slot))
        table = cls(descriptor, slots, samples_per_slot)
        table._set_word("temperature_mc", MISSING)
        table.rows[:] = _empty(SAMPLE_FIELDS, SAMPLE_DTYPE)
        table.fast[:] = _empty(FAST_FIELDS, FAST_DTYPE)
        return table

    @property
    def rows(self) -> NDArray[np.void]:
        """All rows, shape (slots,); those below `done` are final."""
        if self._rows is None:
            raise ValueError("the slot table is closed")
        return self._rows

    @property
    def fast(self) -> NDArray[np.void]:
        """The several samples of every slot, shape (slots x samples,); none where it has one."""
        if self._fast is None:
            raise ValueError("the slot table is closed")
        return self._fast

    @property
    def done(self) -> int:
        """How many slots, from the first, are settled: played and answered, lost, or skipped."""
        return self._word("done")

    @done.setter
    def done(self, slots: int) -> None:
        self._set_word("done", slots)

    @property
    def stop_asked(self) -> bool:
        """Whether the session wants the rig stopped."""
        return bool(self._word("stop"))

    def ask_stop(self) -> None:
        """Ask the loop to stop the rig at its next slot."""
        self._set_word("stop", 1)

    @property
    def slot(self) -> int:
        """The slot that the loop plays now."""
        return self._word("slot")

    @slot.setter
    def slot(self, slot: int) -> None:
        self._set_word("slot", slot)

    @property
    def missed(self) -> int:
        """How many slots were skipped so far."""
        return self._word("missed")

    @missed.setter
    def missed(self, slots: int) -> None:
        self._set_word("missed", slots)

    @property
    def stage(self) -> Stage:
        """Where the loop is."""
        return Stage(self._word("stage"))

    @stage.setter
    def stage(self, stage: Stage) -> None:
        self._set_word("stage", stage)

    @property
    def beat_ns(self) -> int:
        """When the loop last began a slot, or a cycle of its own before the first and after the
        last; 0 until the drive is led to be enabled."""
        return self._word("beat_ns")

    @beat_ns.setter
    def beat_ns(self, now_ns: int) -> None:
        self._set_word("beat_ns", now_ns)

    @property
    def temperature_c(self) -> float | None:
        """The drive's temperature as its samples told it last; None where they do not."""
        told = self._word("temperature_mc")
        return None if told == MISSING else told * 1e-3

    @temperature_c.setter
    def temperature_c(self, temperature_c: float) -> None:
        self._set_word("temperature_mc", round(temperature_c * 1e3))

    @property
    def watch_ns(self) -> int:
        """When the supervisor last looked; 0 where none watches."""
        return self._word("watch_ns")

    @watch_ns.setter
    def watch_ns(self, now_ns: int) -> None:
        self._set_word("watch_ns", now_ns)

    @property
    def trip(self) -> Trip | None:
        """What the supervisor tripped on; None where it has not."""
        if self._words is None:
            raise ValueError("the slot table is closed")
        if not self._word("trip_ns"):
            return None
        kind, text = (bytes(self._words[it]).rstrip(b"\0") for it in ("trip_kind", "trip_text"))
        return Trip(kind.decode("ascii"), text.decode("utf-8", errors="ignore"))

    def latch(self, trip: Trip, now_ns: int) -> None:
        """Keep the cause of a trip; the first one stays."""
        if self._words is None:
            raise ValueError("the slot table is closed")
        if not self._word("trip_ns"):
            self._words["trip_kind"] = trip.kind.encode("ascii")
            self._words["trip_text"] = trip.text.encode()[:_TRIP_TEXT_BYTES]
            self._set_word("trip_ns", now_ns)

    def _word(self, name: str) -> int:
        if self._words is None:
            raise ValueError("the slot table is closed")
        return int(self._words[name])

    def _set_word(self, name: str, value: int) -> None:
        if self._words is None:
            raise ValueError("the slot table is closed")
        self._words[name] = value

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._rows = self._fast = self._words = (
            None  # memory cannot be unmapped while arrays look at it
        )
        self._memory.close()
        os.close(self.descriptor)


def _fast_rows(slots: int, samples_per_slot: int) -> int:
    return slots * samples_per_slot if samples_per_slot > 1 else 0


def _size(slots: int, samples_per_slot: int) -> int:
    rows_bytes = slots * SAMPLE_DTYPE.itemsize
    fast_bytes = _fast_rows(slots, samples_per_slot) * FAST_DTYPE.itemsize
    return _WORDS.itemsize + rows_bytes + fast_bytes
