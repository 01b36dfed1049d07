"""A bus loop's lateness with the machine's own holes told apart."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from servo_bench.benchmark.listener import spread_us
from servo_bench.benchmark.reference import (
    Reference,
    outside,
    references_on_every_cpu,
    stolen_windows,
)
from servo_bench.clock import NS_PER_S
from servo_bench.excitation.experiment import Experiment
from servo_bench.recording.recording import Recording
from servo_bench.run.realtime import PRIORITY

BEGINNING_S = 8.0
"""From asking for a run to its first slot, and room."""


class Lateness(NamedTuple):
    """Of one run or of several: its rows, those outside of the machine's holes, and the C loops'
    own lateness meanwhile; in s."""

    all_s: NDArray[np.float64]
    clean_s: NDArray[np.float64]
    reference_s: NDArray[np.float64]

    @classmethod
    def of(
        cls, recording: Recording, references: Sequence[Reference], margin_ns: int
    ) -> "Lateness":
        """Waits for the C loops' end; rows after it are not clean."""
        due_ns, late_ns = map(np.concatenate, zip(*(one.rows() for one in references), strict=True))
        asked_ns, late_s = recording["asked_ns"], recording["lateness_s"]
        clean = outside(asked_ns, stolen_windows(due_ns, late_ns), margin_ns)
        clean &= asked_ns < due_ns.max()
        during = (due_ns >= asked_ns[0]) & (due_ns <= asked_ns[-1])
        return cls(late_s, late_s[clean], late_ns[during] / NS_PER_S)

    @classmethod
    def together(cls, runs: Sequence["Lateness"]) -> "Lateness":
        """Several runs as one."""
        return cls(*map(np.concatenate, zip(*runs, strict=True)))

    def figures(self) -> dict[str, dict[str, float]]:
        """Ready for JSON."""
        return {
            "raw": spread_us(self.all_s.tolist()),
            "clean": spread_us(self.clean_s.tolist()),
            "reference": spread_us(self.reference_s.tolist()),
        }


def references_beside(
    experiment: Experiment,
) -> AbstractContextManager[tuple[Reference, ...]]:
    """C loops on every CPU for as long as a run of it, beginning soon, will take.

    They go before the loop: one that waits for a long turn of the loop would call that a hole of
    the machine, and excuse the loop by itself.
    """
    return references_on_every_cpu(
        priority=PRIORITY + 1,
        period_ns=period_ns(experiment),
        seconds=experiment.schedule().duration_s + BEGINNING_S,
    )


def period_ns(experiment: Experiment) -> int:
    """Its period on the clock's own scale."""
    return round(experiment.period_s * NS_PER_S)
