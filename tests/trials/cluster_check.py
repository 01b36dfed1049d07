"""The same trials by a real local Dask cluster and by processes: the same lines. Not in pytest.

python -m tests.trials.cluster_check
"""

import sys
import tempfile
from pathlib import Path
from typing import Any

from distributed import LocalCluster

from servo_bench.errors import ConfigError
from servo_bench.jobs import executor
from tests.campaign import run
from tests.trials.asking import Campaign
from tests.trials.lines import Lines

SMALL = Campaign(
    effects=("cogging", "transport_delay"),
    seeds=1,
    nulls=1,
    outside=1,
    first_seed=1300,
    seconds=12.0,
)


def lines_of(path: Path, scheduler: str | None) -> list[dict[str, Any]]:
    """What the campaign found, in the order of its seeds, without its cost."""
    with Lines(path, resume=False) as lines, executor(scheduler=scheduler) as pool:
        run(SMALL.questions(), pool, lines)
        found = [{k: line[k] for k in ("question", "hidden", "score")} for line in lines.lines]
    return sorted(found, key=lambda line: int(line["question"]["seed"]))


def main() -> int:
    """0 where both found the same."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        local: Any = LocalCluster  # untyped
        with local(
            n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
        ) as cluster:
            address = cluster.scheduler_address
            by_cluster = lines_of(folder / "cluster.jsonl", address)
        by_processes = lines_of(folder / "processes.jsonl", None)
        try:
            lines_of(folder / "gone.jsonl", address)
        except ConfigError as error:
            sys.stdout.write(f"a cluster that is gone: {error}\n")
        else:
            sys.stdout.write("a cluster that is gone was not noticed\n")
            return 1
    sys.stdout.write(f"{len(by_cluster)} trials on a Dask cluster at {address}\n")
    if by_cluster != by_processes:
        sys.stdout.write("the cluster and the processes found different things\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
