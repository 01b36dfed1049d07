"""The C reference loop: compiled where it is needed, run beside the loop that is judged."""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from servo_bench.clock import NS_PER_S, monotonic_ns
from servo_bench.errors import BenchError

SOURCE = Path(__file__).with_name("cref.c")
STOLEN_S = 0.0005
"""A C loop that is later than this had its processor taken away."""


class Reference:
    """A running reference loop; `rows` waits for its end."""

    def __init__(self, process: "subprocess.Popen[bytes]") -> None:
        self._process = process

    def rows(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Deadlines and lateness in ns, each of shape (cycles,)."""
        data, _ = self._process.communicate()
        if self._process.returncode != 0:
            raise BenchError(
                f"the reference loop ended with status {self._process.returncode}: 4 means its CPU "
                "was refused, 5 that SCHED_FIFO was. Give --priority 0 or run with the right."
            )
        pairs = np.frombuffer(data, np.int64).reshape(-1, 2)
        return pairs[:, 0], pairs[:, 1]


@contextmanager
def running_reference(
    *, priority: int, cpu: int, start_ns: int, period_ns: int, cycles: int
) -> Iterator[Reference]:
    """Compile and start the reference; it is killed when the block is left.

    Raises BenchError where there is no C compiler.
    """
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        raise BenchError("no C compiler: the reference loop needs one. Install gcc, or set CC.")
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "cref"
        subprocess.run([compiler, "-O2", "-o", program, SOURCE], check=True)
        arguments = [str(number) for number in (priority, cpu, start_ns, period_ns, cycles)]
        process = subprocess.Popen([program, *arguments], stdout=subprocess.PIPE)
        try:
            yield Reference(process)
        finally:
            process.kill()
            process.wait()


@contextmanager
def references_on_every_cpu(
    *, priority: int, period_ns: int, seconds: float
) -> Iterator[tuple[Reference, ...]]:
    """One on each CPU that this process may use, from now on: for loops that are not pinned."""
    with ExitStack() as stack:
        yield tuple(
            stack.enter_context(
                running_reference(
                    priority=priority,
                    cpu=cpu,
                    start_ns=monotonic_ns() + period_ns,
                    period_ns=period_ns,
                    cycles=round(seconds * NS_PER_S / period_ns),
                )
            )
            for cpu in sorted(os.sched_getaffinity(0))
        )


def stolen_windows(due_ns: NDArray[np.int64], late_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Begin and end in ns of each hole, shape (holes, 2)."""
    hit = late_ns > STOLEN_S * NS_PER_S
    return np.column_stack([due_ns[hit], due_ns[hit] + late_ns[hit]])


def outside(
    at_ns: NDArray[np.int64], stolen: NDArray[np.int64], margin_ns: int
) -> NDArray[np.bool]:
    """Which times are further than `margin_ns` from every hole."""
    clean = np.ones(at_ns.size, np.bool)
    for begin_ns, end_ns in stolen:
        clean &= (at_ns < begin_ns - margin_ns) | (at_ns > end_ns + margin_ns)
    return clean
