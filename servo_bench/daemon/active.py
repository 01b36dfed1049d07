"""The run that plays: its folder, its runner, and what is known of it from moment to moment.

A run folder (state/runs/ID) holds, until the run is over, catalogued, and analysed:

    waiting.json   what was asked, as it stood in the queue
    job.json       what the runner was given
    runner.json    the runner's process id
    control.sock   the runner's socket
    runner.log     what the runner said on stderr
    result.json    what became of the run
"""

import asyncio
import os
import shutil
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from servo_bench.clock import monotonic_ns
from servo_bench.daemon.job import JOB, RESULT, RUNNER, RunJob, RunResult
from servo_bench.daemon.link import Message, RunnerLink
from servo_bench.daemon.live import TableSource
from servo_bench.daemon.queue import Waiting
from servo_bench.daemon.sockets import SOCKET, listening
from servo_bench.daemon.store import read_json, write_json

WAITING, LOG = "waiting.json", "runner.log"
LAST_WORDS_BYTES = 2000


@dataclass
class ActiveRun:
    """One run from its start to its result; belongs to the event loop that made it."""

    asked: Waiting
    folder: Path
    job: RunJob
    ended: asyncio.Event = field(default_factory=asyncio.Event)
    link: RunnerLink | None = None
    process: asyncio.subprocess.Process | None = None
    status: Message = field(default_factory=dict)
    said: RunResult | None = None
    source: TableSource | None = None
    stop_by: str = ""
    slot: int = 0
    slot_since_ns: int = field(default_factory=monotonic_ns)
    silent: bool = False
    """Whether the bus process has not played a slot for too long."""

    def __post_init__(self) -> None:
        schedule = self.job.experiment.schedule()
        self.slots, self.duration_s = schedule.slots, schedule.duration_s

    def took(self, message: Message) -> None:
        """A message of the runner."""
        if message["kind"] == "status":
            self.status = message
        elif message["kind"] == "result":
            self.said = RunResult.from_table({k: v for k, v in message.items() if k != "kind"})
        elif message["kind"] == "table" and self.stop_by:
            self.ask_stop(self.stop_by)  # it was asked before there was a table

    def ask_stop(self, by: str) -> None:
        """Stop the rig as soon as it can be: within a slot where it plays."""
        self.stop_by = self.stop_by or by
        if self.link is not None:
            self.link.ask_stop(self.stop_by)

    def end_runner(self) -> bool:
        """Tell a runner that nobody will watch to stop the rig; False where none was started."""
        if self.process is None:
            return False
        with suppress(ProcessLookupError):  # it has ended
            self.process.terminate()
        return True

    @property
    def runner_pid(self) -> int | None:
        """The runner's process, dead or alive; None where it never came so far."""
        if self.process is not None:
            return self.process.pid
        return runner_pid(self.folder)

    def result(self) -> RunResult | None:
        """What became of the run, as the runner said or wrote it; None where it did neither."""
        if self.said is not None:
            return self.said
        return result_in(self.folder)

    def last_words(self) -> str:
        """The last line that the runner wrote to stderr."""
        return last_words(self.folder)


def has_begun(folder: Path) -> bool:
    """Whether a run's runner was ever started: its socket is made before it."""
    return (folder / RUNNER).exists() or (folder / SOCKET).exists()


def without_a_word(run: ActiveRun) -> RunResult:
    """What is said of a run whose runner was killed, or never came to be."""
    if not has_begun(run.folder):
        sentence = "the daemon ended before it could begin; nothing moved. Ask for it again."
        return RunResult("nothing", sentence)
    words = run.last_words()
    left = "what it recorded until then is kept" if run.job.out.exists() else "nothing was recorded"
    said = f" It last said: {words}." if words else ""
    return RunResult(
        "cut", f"the run's process was killed; the bus process stopped the rig, and {left}.{said}"
    )


def result_in(folder: Path) -> RunResult | None:
    """The result that a runner has left in its folder."""
    table = read_json(folder / RESULT)
    return RunResult.from_table(table) if table is not None else None


def runner_pid(folder: Path) -> int | None:
    """The process id that a runner has left in its folder."""
    table = read_json(folder / RUNNER)
    return int(table["pid"]) if table is not None else None


def last_words(folder: Path) -> str:
    """The end of what a runner wrote to stderr, one line."""
    try:
        with (folder / LOG).open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - LAST_WORDS_BYTES))
            lines = file.read().decode(errors="replace").strip().splitlines()
    except OSError:
        return ""
    return lines[-1] if lines else ""


def prepare(folder: Path, asked: Waiting, job: RunJob) -> ActiveRun:
    """Make the run's folder; RecordingError where the disk does not take it."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / JOB, job.table())
    write_json(folder / WAITING, asdict(asked))
    return ActiveRun(asked, folder, job)


async def launch(run: ActiveRun, lock_descriptor: int, gone: Callable[[], None]) -> None:
    """Start the runner and connect to it; OSError where the system has no process to give.

    Nobody could stop what a runner plays to which there is no connection: `end_runner` then.
    """
    log = os.open(run.folder / LOG, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    try:
        with listening(run.folder) as listener:
            run.process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "servo_bench.daemon.runner"),
                *(str(run.folder), str(listener.fileno()), str(lock_descriptor)),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=(listener.fileno(), lock_descriptor),
                start_new_session=True,
            )
            attach(run, gone)
    finally:
        os.close(log)


def attach(run: ActiveRun, gone: Callable[[], None]) -> None:
    """Connect to the run's living runner; OSError where none lives."""
    run.link = RunnerLink(run.folder, run.took, gone)
    if run.stop_by:
        run.ask_stop(run.stop_by)


def left_over(runs: Path) -> list[ActiveRun]:
    """The runs whose folders an earlier daemon has left; folders without a job are removed."""
    found = []
    for folder in sorted(runs.iterdir()) if runs.is_dir() else []:
        asked, job = read_json(folder / WAITING), read_json(folder / JOB)
        if asked is None or job is None:
            discard(folder)
        else:
            found.append(ActiveRun(Waiting(**asked), folder, RunJob.from_table(job)))
    return found


def discard(folder: Path) -> None:
    """Take a run's folder away."""
    shutil.rmtree(folder, ignore_errors=True)


def run_facts(asked: Waiting) -> dict[str, str]:
    """What a recording's provenance says about who wanted it."""
    return {
        "run_id": asked.id,
        "run_name": asked.name,
        "operator": asked.operator,
        "run_notes": asked.notes,
    }


def status_table(run: ActiveRun) -> dict[str, Any]:
    """The run as the status shows it."""
    known = {
        "phase": "preparing",
        "slot": 0,
        "slots": run.slots,
        "seconds_left": run.duration_s,
        "missed": 0,
        "lateness_p50_s": 0.0,
        "lateness_max_s": 0.0,
    }
    said = {key: value for key, value in run.status.items() if key in known}
    asked = {key: getattr(run.asked, key) for key in ("id", "name", "experiment", "operator")}
    return {**asked, **known, **said}
