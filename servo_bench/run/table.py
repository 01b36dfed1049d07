"""The table that the bus loop fills and the session reads: shared memory, no locks, no calls.

One row of SAMPLE_DTYPE for every slot of the schedule, allocated before the run, and a few words
beside it. The loop alone writes rows and `done`; the session alone writes `stop`. Every word is
an aligned 64-bit integer, which x86-64 and AArch64 store whole; `done` is stored after the rows
it covers.
"""

import mmap
import os
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from servo_bench.recording.recording import MISSING, SAMPLE_DTYPE, SAMPLE_FIELDS

UNPLAYED = -1
"""The `slot` of a row whose slot was skipped or is still to come."""

_WORDS = np.dtype([("done", "<i8"), ("stop", "<i8"), ("slot", "<i8"), ("missed", "<i8")])
_EMPTY = np.zeros((), SAMPLE_DTYPE)
for _name, _kind in SAMPLE_FIELDS:
    if _kind == "float64":
        _EMPTY[_name] = np.nan
    elif _kind == "int64":
        _EMPTY[_name] = MISSING
_EMPTY["slot"] = UNPLAYED


class SlotTable:
    """Rows and words in memory that two processes share; closing it frees this side's view.

    The memory has no name, only a descriptor that the session hands to the loop: it vanishes with
    the last process that holds it, however that one ends.
    """

    def __init__(self, descriptor: int, slots: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, _size(slots))
        self._words: NDArray[np.void] | None = np.ndarray((), _WORDS, self._memory)
        self._rows: NDArray[np.void] | None = np.ndarray(
            (slots,), SAMPLE_DTYPE, self._memory, offset=_WORDS.itemsize
        )

    @classmethod
    def create(cls, slots: int) -> Self:
        """A table of empty rows."""
        descriptor = os.memfd_create("servo-bench-slots")
        os.ftruncate(descriptor, _size(slots))
        table = cls(descriptor, slots)
        table.rows[:] = _EMPTY
        return table

    @property
    def rows(self) -> NDArray[np.void]:
        """All rows, shape (slots,); those below `done` are final."""
        if self._rows is None:
            raise ValueError("the slot table is closed")
        return self._rows

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
        self._rows = self._words = None  # memory cannot be unmapped while arrays look at it
        self._memory.close()
        os.close(self.descriptor)


def _size(slots: int) -> int:
    return _WORDS.itemsize + slots * SAMPLE_DTYPE.itemsize
