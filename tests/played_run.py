"""A run as a program of its own, for tests that end it from outside.

    python -m tests.played_run JOB.json OUT.mcap

Heeds SIGINT and SIGTERM as the command line does, and prints one line for every look at the run.
"""

import json
import sys
from pathlib import Path

from servo_bench.cli.stopping import asked_to_stop
from servo_bench.excitation.experiment import experiment_from_table
from servo_bench.rig import rig_from_table
from servo_bench.run.session import Status, run


def main(job: Path, out: Path) -> None:
    """Play the job and say where it is."""
    table = json.loads(job.read_text())

    def progress(status: Status) -> None:
        if status.slot > 60:
            sys.stdout.write(f"playing {status.slot}\n")
            sys.stdout.flush()

    with asked_to_stop() as stop:
        run(
            experiment_from_table(table["experiment"], str(job)),
            rig_from_table(table["rig"], str(job)),
            out,
            progress=progress,
            stop=stop,
            stopped_by=lambda: stop.by,
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
