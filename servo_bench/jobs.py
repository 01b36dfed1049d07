"""Many jobs at once: the one seam is `concurrent.futures.Executor`.

    with executor() as pool:                                  processes on this machine
    with executor(scheduler="tcp://10.0.0.7:8786") as pool:   a Dask cluster's workers

A job is a function that can be imported by name where it runs, of values that can be pickled. On a
cluster every worker needs the same version of what it imports, and sees the files that it is given.
"""

import importlib
import multiprocessing
import os
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

from servo_bench.errors import ConfigError

CONNECT_TIMEOUT_S = 10.0


@contextmanager
def executor(jobs: int | None = None, scheduler: str | None = None) -> Iterator[Executor]:
    """An executor of `jobs` processes (default: one a core), or that of a Dask scheduler.

    Leaving it cancels what has not begun, and waits for what has. Raises ConfigError where `jobs`
    is not positive or given beside a scheduler, where the extra `cluster` is not installed, and
    where no scheduler answers.
    """
    if jobs is not None and jobs < 1:
        raise ConfigError(f"--jobs {jobs}: at least one process must work. Give 1 or more.")
    if scheduler is None:
        # Spawned, not forked: a fork copies locks that threads of this process may hold.
        context = multiprocessing.get_context("spawn")
        pool: Executor = ProcessPoolExecutor(
            jobs or os.cpu_count() or 1, mp_context=context, initializer=end_with_the_parent
        )
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)
        return
    if jobs is not None:
        raise ConfigError(
            f"--jobs {jobs} and --scheduler {scheduler}: a cluster has the workers that it has. "
            "Give one of the two."
        )
    with _client(scheduler) as client, client.get_executor(pure=False) as pool:
        yield pool  # not pure: the same job given twice is two jobs


def end_with_the_parent() -> None:
    """Let this worker end when what started it does: a killed one tells nobody to stop."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent,), daemon=True).start()


def _end_after(parent: Any) -> None:
    parent.join()
    os._exit(1)


def _client(scheduler: str) -> Any:
    """A Dask client of the scheduler at this address; ConfigError where there is none."""
    try:
        distributed = importlib.import_module("distributed")
    except ImportError as error:
        raise ConfigError(
            f"--scheduler {scheduler} needs Dask, which is not installed ({error}): "
            "pip install 'servo-bench[cluster]', or leave --scheduler away for processes here."
        ) from error
    try:
        return distributed.Client(scheduler, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"no Dask scheduler answers at {scheduler} within {CONNECT_TIMEOUT_S:g} s ({error}). "
            "Start one (dask scheduler), or correct the address: tcp://HOST:PORT."
        ) from error
