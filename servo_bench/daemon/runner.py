"""One run, in a process that neither the web side's crash nor its restart disturbs.

    python -m servo_bench.daemon.runner FOLDER LISTENER LOCK

FOLDER holds `job.json`, and gets `runner.json` with this process's id. LISTENER and LOCK are
inherited descriptors: the socket that `control` serves, and the rig's lock, which is held as long
as this process lives. What became of the run is written to `result.json` when the rig stands. No
pipe leads to the daemon: it may die at any time.
"""

import os
import signal
import socket
import sys
from contextlib import ExitStack, suppress
from dataclasses import asdict
from pathlib import Path
from types import FrameType
from typing import Any

from servo_bench.daemon.control import Control
from servo_bench.daemon.job import JOB, RESULT, RUNNER, RunJob, RunResult
from servo_bench.daemon.store import read_json, write_json
from servo_bench.errors import BenchError, RecordingError, gathered
from servo_bench.run.session import RunSummary, Status, run
from sim_rig.process import spawn


def play(job: RunJob, control: Control) -> RunResult:
    """Play the job and say what became of it; the rig stands when this returns."""
    try:
        with ExitStack() as stack, gathered():
            rig = job.rig
            if job.simulated:
                started = stack.enter_context(spawn(rig.on_a_free_port().simulation_settings()))
                rig = rig.as_simulated(**started.bus)
            summary = run(
                job.experiment,
                rig,
                job.out,
                progress=lambda status: control.tell(_status_table(status)),
                stop=lambda: control.stop_asked,
                stopped_by=lambda: control.asked_by,
                opened=lambda table: control.show(table, job.experiment.period_s),
                facts=job.facts,
                priority=job.priority,
                cpu=job.cpu,
            )
    except BenchError as error:
        return RunResult("faulted", str(error), error=type(error).__name__)
    return _result(summary, control.asked_by)


def _result(summary: RunSummary, asked_by: str) -> RunResult:
    counts = (summary.slots, summary.played, summary.missed, summary.sentences)
    if summary.played == 0:
        sentence = f"stopped by {asked_by or 'an operator'} before anything moved."
        return RunResult("nothing", sentence, "", *counts)
    how = f"{summary.played} of {summary.slots} slots played, {summary.missed} missed"
    if summary.stopped_early:
        return RunResult("stopped", f"stopped by {asked_by or 'an operator'}: {how}.", "", *counts)
    return RunResult("complete", f"complete: {how}.", "", *counts)


def _status_table(status: Status) -> dict[str, Any]:
    table = {**asdict(status), "phase": status.phase.name.lower().replace("_", "-")}
    return {"kind": "status", **table}


def main(folder: Path, listener: int, lock: int) -> int:
    """Entry point of the process: 0 when the run has a result, whatever that is."""
    table = read_json(folder / JOB)
    if table is None:
        return 1
    job = RunJob.from_table(table)
    write_json(folder / RUNNER, {"pid": os.getpid()})
    control = Control(socket.socket(fileno=listener), lock, job.id, alone_for_s=job.stop_alone_s)

    def stop(number: int, frame: FrameType | None) -> None:  # noqa: ARG001
        control.ask_stop(signal.Signals(number).name)

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    control.start()
    result = play(job, control)
    control.tell({"kind": "result", **asdict(result)})
    with suppress(RecordingError):  # a full disk: who listens has been told
        write_json(folder / RESULT, asdict(result))
    os.close(lock)
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])))
