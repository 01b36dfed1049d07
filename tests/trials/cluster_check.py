"""The executor seam on a real local Dask cluster, and trials there as in processes here.

    python -m tests.trials.cluster_check          exit status 0 where all of it holds

What a user types, `python -m tests.campaign --scheduler tcp://...`, must write the lines that it
writes without a cluster. Dask is the extra `cluster`; a minute, so not in the test command.
"""

import json
import logging
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from distributed import LocalCluster

from servo_bench.errors import ConfigError
from servo_bench.jobs import executor
from tests.campaign import main as campaign

SMALL = (
    *("--effects", "transport_delay", "--seeds", "1", "--nulls", "1"),
    *("--first-seed", "1300", "--seconds", "6"),
)
WORKERS = 2


@contextmanager
def cluster() -> Iterator[str]:
    """The address of a scheduler with two workers, processes of one thread each."""
    local: Any = LocalCluster  # untyped
    with local(
        n_workers=WORKERS,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address=None,
        silence_logs=logging.CRITICAL,  # at its end its workers are cut off, and complain
    ) as running:
        yield running.scheduler_address


def laws(pool: Executor) -> list[str]:
    """What an executor must do and this one does not."""
    broken = []
    if [future.result() for future in [pool.submit(abs, -k) for k in range(20)]] != [*range(20)]:
        broken.append("results are those of other jobs")
    if not isinstance(pool.submit(int, "no number").exception(), ValueError):
        broken.append("a job's own error does not come back")
    once, again = pool.submit(os.urandom, 8), pool.submit(os.urandom, 8)
    if once.result() == again.result():
        broken.append("the same job given twice is done once")
    if os.getpid() in {pool.submit(os.getpid).result() for _ in range(4)}:
        broken.append("jobs run in the process that gives them")
    return broken


def lines_of(path: Path, *options: str) -> list[dict[str, Any]]:
    """What the campaign's command line found, in the order of its seeds, without its cost."""
    if campaign(["--json", str(path), *SMALL, *options]) != 0:
        return []
    lines = [json.loads(line) for line in path.with_suffix(".jsonl").read_text().splitlines()]
    kept = [{k: line[k] for k in ("question", "hidden", "score", "failure")} for line in lines]
    return sorted(kept, key=lambda line: int(line["question"]["seed"]))


def differences(there: Sequence[dict[str, Any]], here: Sequence[dict[str, Any]]) -> list[str]:
    """In words, what cluster and processes do not agree on, or failed at."""
    if len(there) != len(here) or not here:
        return [f"{len(there)} trials on the cluster, {len(here)} in processes"]
    found = [f"failed: {line['failure']}" for line in (*there, *here) if line["failure"]]
    for one, other in zip(there, here, strict=True):
        found += [
            f"seed {one['question']['seed']}, {key}: {one[key]} on the cluster, {other[key]} here"
            for key in one
            if one[key] != other[key]
        ]
    return found


def unanswered(address: str) -> list[str]:
    """A scheduler that is gone must be said in words, by whoever asks for it."""
    try:
        with executor(scheduler=address):
            return ["a cluster that is gone is not noticed"]
    except ConfigError as error:
        return [] if address in str(error) else [f"a cluster that is gone is not named: {error}"]


def main() -> int:
    """0 where nothing is wrong."""
    began_s = time.monotonic()

    def told(what: str, look: Callable[[], list[str]]) -> int:
        wrong = look()
        verdict = "; ".join(wrong) or "holds"
        sys.stdout.write(f"{what}: {verdict} ({time.monotonic() - began_s:.0f} s)\n")
        return len(wrong)

    def both() -> list[str]:
        there = lines_of(folder / "cluster.json", "--scheduler", address)
        return differences(there, lines_of(folder / "processes.json", "--jobs", str(WORKERS)))

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with cluster() as address:
            with executor(scheduler=address) as pool:
                wrong = told(f"an executor of the cluster at {address}", lambda: laws(pool))
            wrong += told("a campaign on it, as in processes", both)
        wrong += told("a cluster that is gone", lambda: unanswered(address))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
