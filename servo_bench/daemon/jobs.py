"""Work on recordings in processes of their own, as idle as the system allows.

    python -m servo_bench.daemon.work KIND CPUS RECORDING...

One analysis or comparison at a time, and beside it one diagnosis: that may take minutes, and what
a run waits for must not wait for it, nor for what others have asked for. The bus loop must not feel
them: they are nice, single-threaded, and keep off the loop's CPU.
"""

import asyncio
import json
import os
import secrets
import signal
import sys
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from servo_bench.catalogue.run import printable
from servo_bench.daemon.problems import ApiError
from servo_bench.daemon.turn import Turn
from servo_bench.errors import FitError

KEPT = 100
WAITING = 20
MAX_LINE_BYTES = 8 << 20
LONGEST_PROGRESS = 200
Kind = Literal["analyse", "diagnose"]
JobState = Literal["waiting", "running", "done", "failed"]
SINGLE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


@dataclass(frozen=True, slots=True)
class Job:
    """One piece of work: `progress` is what it does now, `sentence` says how it ended."""

    id: str
    kind: Kind
    run: str
    state: JobState = "waiting"
    progress: str = ""
    sentence: str = ""


@dataclass
class _Comparison:
    """One that waits or works, and how many wait for it."""

    task: "asyncio.Task[dict[str, Any]]"
    wanted: int = 0


async def _nothing() -> None:
    """Nothing follows the end of a job."""


class Jobs:
    """The jobs of this daemon's life; the oldest are forgotten."""

    def __init__(
        self,
        loop_cpu: int | None,
        changed: Callable[[], None] = lambda: None,
        made: Callable[[], Awaitable[None]] = _nothing,
    ) -> None:
        """`changed` is called at every change of a job, `made` before one is said to be over."""
        self._changed = changed
        self._made = made
        self._jobs: dict[str, Job] = {}
        self._quick, self._long = Turn(), Turn()
        self._tasks: dict[str, asyncio.Task[Job]] = {}
        self._comparisons: dict[tuple[Path, Path], _Comparison] = {}
        self._cpus = (os.sched_getaffinity(0) - {loop_cpu}) or os.sched_getaffinity(0)

    @property
    def open(self) -> tuple[Job, ...]:
        """The jobs that wait or work, in the order in which they were asked for."""
        known = (self._jobs[job_id] for job_id in self._tasks)
        return tuple(job for job in known if job.state in ("waiting", "running"))

    def get(self, job_id: str) -> Job:
        """The job; ApiError where there is none, or no longer."""
        if job_id not in self._jobs:
            raise ApiError(
                404,
                "no-such-job",
                f"there is no job {job_id[:40]!r}: the last {KEPT} since the daemon's start are "
                "known. What it made is beside the recording.",
            )
        return self._jobs[job_id]

    def start(self, kind: Kind, run: str, recording: Path, *, own: bool = False) -> Job:
        """Begin when it is its turn; one that waits or works already is the same job.

        The daemon's own goes first, however many wait. ApiError where too many do.
        """
        same = next((job for job in self.open if (job.kind, job.run) == (kind, run)), None)
        if same is not None:
            return same
        if not own:
            self._check_room()
        job = self._keep(Job(secrets.token_hex(8), kind, run))
        task = asyncio.create_task(self._run(job, recording, own))
        self._tasks[job.id] = task
        task.add_done_callback(lambda _: self._tasks.pop(job.id))
        return job

    async def ended(self, job: Job) -> Job:
        """The job when it is over."""
        task = self._tasks.get(job.id)
        if task is not None:
            await asyncio.wait([task])
        return self._jobs[job.id]

    async def close(self) -> None:
        """End what works."""
        comparing = [comparison.task for comparison in self._comparisons.values()]
        tasks = [*self._tasks.values(), *comparing]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def compared(self, before: Path, after: Path) -> dict[str, Any]:
        """Two recordings side by side, done once for all who ask; ended when nobody waits for it.

        FitError with the reason where it cannot be done, ApiError where too many wait.
        """
        pair = (before, after)
        if pair not in self._comparisons:
            self._check_room()
            task = asyncio.create_task(self._compare(pair))
            self._comparisons[pair] = _Comparison(task)
        comparison = self._comparisons[pair]
        comparison.wanted += 1
        try:
            return await asyncio.shield(comparison.task)
        except asyncio.CancelledError:
            if comparison.task.cancelled():
                raise ApiError(503, "ending", "the daemon ends. Ask when it is back.") from None
            raise
        finally:
            comparison.wanted -= 1
            if comparison.wanted == 0:
                comparison.task.cancel()
                self._forget(pair, comparison)

    async def _compare(self, pair: tuple[Path, Path]) -> dict[str, Any]:
        async with self._quick.taken():
            status, words = await self._work("compare", *pair)
        if status != 0:
            raise FitError(words)
        table: dict[str, Any] = json.loads(words)
        return table

    def _forget(self, pair: tuple[Path, Path], comparison: _Comparison) -> None:
        """Whoever asks for this pair from now on begins anew."""
        if self._comparisons.get(pair) is comparison:
            del self._comparisons[pair]

    def _check_room(self) -> None:
        if len(self.open) + len(self._comparisons) > WAITING:
            raise ApiError(
                429, "many-jobs", f"{WAITING} jobs wait already. Ask again when some are done."
            )

    async def _run(self, job: Job, recording: Path, own: bool) -> Job:
        turn = self._long if job.kind == "diagnose" else self._quick
        async with turn.taken(urgent=own):
            job = self._keep(replace(job, state="running"))
            try:
                status, words = await self._work(
                    job.kind, recording, told=lambda line: self._tell(job, line)
                )
            except OSError as error:
                status, words = 1, f"no process could be had for it: {error.strerror}. Ask again."
            await self._made()
            state: JobState = "done" if status == 0 else "failed"
            return self._keep(replace(job, state=state, progress="", sentence=words))

    def _tell(self, job: Job, line: str) -> None:
        self._keep(replace(job, progress=printable(line, LONGEST_PROGRESS)))

    async def _work(
        self, kind: str, *recordings: Path, told: Callable[[str], None] = lambda _: None
    ) -> tuple[int, str]:
        """Exit status and last line of a piece of work; killed where nobody waits any more."""
        cpus = ",".join(str(cpu) for cpu in sorted(self._cpus))
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-W", "ignore", "-m", "servo_bench.daemon.work", kind, cpus),
            *(str(recording) for recording in recordings),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            limit=MAX_LINE_BYTES,
            env={**os.environ, **SINGLE},
            start_new_session=True,
        )
        last = ""
        try:
            while process.stdout and (line := await process.stdout.readline()):
                if words := line.decode(errors="replace").strip():
                    told(last := words)
            status = await process.wait()
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if status < 0:
            doing = f" while it did this: {last[:LONGEST_PROGRESS]}" if last else ""
            return status, f"it was ended by {signal.Signals(-status).name}{doing}. Ask again."
        return status, last or f"it ended with status {status} without a word"

    def _keep(self, job: Job) -> Job:
        self._jobs[job.id] = job
        ended = [job_id for job_id in self._jobs if job_id not in (*self._tasks, job.id)]
        for job_id in ended[: max(0, len(self._jobs) - KEPT)]:
            del self._jobs[job_id]
        self._changed()
        return job
