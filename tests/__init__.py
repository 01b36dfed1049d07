"""Tests, trials, and campaigns; nothing of them is installed.

Linear algebra runs on one thread here: tests and trials share the cores by processes, and threads
of OpenBLAS wait for each other in a busy loop (a fit of 7 s took 13 s of processor).
"""

import os

for _library in ("OPENBLAS", "OMP"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
