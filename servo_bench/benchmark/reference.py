"""The C reference loop: compiled where it is needed, run beside the loop that is judged."""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import BenchError

SOURCE = Path(__file__).with_name("cref.c")


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
