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
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Literal

from servo_bench.daemon.control import Control
from servo_bench.daemon.store import read_json, write_json
from servo_bench.errors import BenchError, ConfigError, RecordingError, gathered
from servo_bench.excitation.experiment import Experiment, experiment_from_table
from servo_bench.rig import RigConfig, rig_from_table
from servo_bench.run.session import RunSummary, Status, run
from sim_rig.process import spawn

JOB, RUNNER, RESULT = "job.json", "runner.json", "result.json"
Outcome = Literal["complete", "stopped", "faulted", "nothing", "cut"]


@dataclass(frozen=True, slots=True)
class RunJob:
    """What the daemon hands over. `facts` go into the recording's provenance."""

    id: str
    experiment: Experiment
    rig: RigConfig
    out: Path
    simulated: bool
    priority: int
    cpu: int | None
    stop_alone_s: float | None
    facts: dict[str, str]

    def table(self) -> dict[str, Any]:
        """The job as it stands in `job.json`."""
        return {
            "id": self.id,
            "experiment": self.experiment.model_dump(mode="json"),
            "rig": self.rig.model_dump(mode="json"),
            "out": str(self.out),
            "simulated": self.simulated,
            "priority": self.priority,
            "cpu": self.cpu,
            "stop_alone_s": self.stop_alone_s,
            "facts": self.facts,
        }

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> "RunJob":
        """The job again; ConfigError where the table is none."""
        try:
            return cls(
                **{
                    **table,
                    "experiment": experiment_from_table(table["experiment"], JOB),
                    "rig": rig_from_table(table["rig"], JOB),
                    "out": Path(table["out"]),
                }
            )
        except (KeyError, TypeError) as error:
            raise ConfigError(f"{JOB} is no job of this version: {error}. Remove it.") from error


@dataclass(frozen=True, slots=True)
class RunResult:
    """What became of a run, in one sentence and a few numbers."""

    outcome: Outcome
    sentence: str
    error: str = ""
    slots: int = 0
    played: int = 0
    missed: int = 0
    notes: tuple[str, ...] = ()

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> "RunResult":
        """The result again, from its JSON."""
        return cls(**{**table, "notes": tuple(table.get("notes", ()))})


def play(job: RunJob, control: Control) -> RunResult:
    """Play the job and say what became of it; the rig stands when this returns."""
    try:
        with ExitStack() as stack, gathered():
            rig = job.rig
            if job.simulated:
                started = stack.enter_context(spawn(rig.on_a_free_port().simulation_settings()))
                rig = rig.with_bus(**started.bus)
            summary = run(
                job.experiment,
                rig,
                job.out,
                progress=lambda status: control.tell(_status_table(status)),
                stop=lambda: control.stop_asked,
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
