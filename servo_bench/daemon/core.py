"""The daemon's heart: one rig, one run at a time, a queue that is held until an operator arms it.

Everything here runs in one event loop and never waits for a run: it starts a runner, watches the
memory that the bus loop fills, and takes note of the runner's end. The order of business when
anything goes wrong: the rig is stopped, the queue is held, only then is anything written.
"""

import asyncio
import json
from collections.abc import Callable
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any

from servo_bench.catalogue import Catalogue
from servo_bench.catalogue.beside import Notes, write_notes
from servo_bench.clock import NS_PER_S, monotonic_ns
from servo_bench.daemon import active as runs
from servo_bench.daemon.active import ActiveRun
from servo_bench.daemon.condition import Condition
from servo_bench.daemon.config import Bench
from servo_bench.daemon.ending import UNKNOWN, End, end_of, stop_takes_s
from servo_bench.daemon.job import RunJob, RunResult
from servo_bench.daemon.jobs import Job, Jobs, Kind
from servo_bench.daemon.live import ReplaySource, Source, TableSource
from servo_bench.daemon.log import Log
from servo_bench.daemon.machine import Event, State
from servo_bench.daemon.problems import ApiError
from servo_bench.daemon.processes import wait_for_bus_processes
from servo_bench.daemon.queue import Queue, Waiting
from servo_bench.daemon.requests import (
    Chosen,
    Overrides,
    check_room,
    chosen,
    new_file,
    recording_bytes,
)
from servo_bench.daemon.turn import Turn
from servo_bench.errors import BenchError, RecordingError
from servo_bench.excitation.experiment import Experiment
from servo_bench.files import validated
from servo_bench.recording.recording import Recording
from servo_bench.run.lock import Holder, Lock, rig_lock_path, take

WATCH_EVERY_S = 0.05
BUS_SILENT_S = 0.8
"""A bus process that has played no slot for so long is taken for gone."""
ARMING_DIGITS = 16


class Daemon:
    """What the web side serves; `bench` says what it may do. Open it, then close it."""

    def __init__(self, bench: Bench, log: Log, now_ns: Callable[[], int] = monotonic_ns) -> None:
        self.bench = bench
        self.catalogue = Catalogue(bench.recordings)
        self.queue = Queue(bench.state, bench.run.max_queue)
        self.condition = Condition(log, bench.recordings)
        self.jobs = Jobs(bench.run.cpu, self.condition.change, self.refresh)
        self.log = log
        self.reachable: bool | None = None
        self._now_ns = now_ns
        self._runs = bench.state / "runs"
        self._active: ActiveRun | None = None
        self._replay: tuple[str, float, ReplaySource] | None = None
        self._state_lock: Lock | None = None
        self._rig_lock: Lock | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._closing = False
        self._choosing = Turn()

    # -- life ---------------------------------------------------------------------------------

    async def open(self, url: str) -> None:
        """Take the locks, find what an earlier daemon has left, begin to watch.

        BusyError naming the holder where the state folder or the rig is somebody else's.
        """
        holder = Holder(f"the daemon of rig {self.bench.rig.name!r}", url=url)
        self._state_lock = take(self.bench.state / "daemon.lock", holder)
        self._runs.mkdir(exist_ok=True)
        for left in runs.left_over(self._runs):
            if not runs.has_begun(left.folder) and self._waits(left.asked.id):
                runs.discard(left.folder)  # it was being prepared, and has its turn again
                continue
            self.queue.remove(left.asked.id)  # it was about to leave the queue
            if self._active is None and self._found(left):
                continue
            await self._bury(left)
        if self._active is None:
            self._rig_lock = take(self._rig_lock_path, holder)
        await self.refresh()
        self._spawn(self._watch())

    async def close(self) -> None:
        """Stop the rig, wait until it stands, end the jobs, let go of the locks."""
        self._closing = True
        run = self._active
        if run is not None:
            self.stop("the daemon's shutdown")
            try:
                await asyncio.wait_for(run.ended.wait(), stop_takes_s(run))
            except TimeoutError:
                self.log.error("the run did not end", run=run.asked.id, pid=run.runner_pid)
        await self.jobs.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if run is not None and run.link is not None:
            run.link.close()
        if self._rig_lock is not None:
            (self._rig_lock.release if self._active is None else self._rig_lock.let_go)()
        if self._state_lock is not None:
            self._state_lock.release()

    def _waits(self, run_id: str) -> bool:
        return any(entry.id == run_id for entry in self.queue)

    def _found(self, left: ActiveRun) -> bool:
        """Take up a run whose runner lives; False where none does."""
        try:
            runs.attach(left, lambda: self._spawn(self._finish(left)))
        except OSError:
            return False
        self._active = left
        self.condition.fire(Event.STARTED)
        self.log.warning("run found", run=left.asked.id)
        return True

    async def _bury(self, left: ActiveRun) -> None:
        """Close a run whose runner died while no daemon watched, or has left its result."""
        pid = left.runner_pid
        if pid is not None:
            await asyncio.to_thread(wait_for_bus_processes, pid, stop_takes_s(left))
        result = left.result() or runs.without_a_word(left)
        self.log.warning("run left over", run=left.asked.id, outcome=result.outcome)
        self.condition.tell(left.asked.id, result.sentence)
        if result.outcome in ("faulted", "cut"):
            self.condition.fail(result.sentence, confirmed=left.job.simulated)
        if self._to_be_analysed(left, result):
            self._spawn(self._analyse_left(left))
        else:
            runs.discard(left.folder)

    # -- what operators do --------------------------------------------------------------------

    async def chosen(self, experiment: str, overrides: dict[str, Any]) -> Chosen:
        """What is asked for, and what it would do; errors as `requests.chosen`.

        A long schedule is laid out beside the event loop, which a stop needs, and one at a time.
        """
        async with self._choosing.taken():
            return await asyncio.to_thread(self._chosen, experiment, overrides)

    async def submit(self, asked: Waiting) -> int:
        """Let a run wait; how many are before it.

        Raises ApiError, ConfigError, or LimitError where it cannot be played, and ApiError where
        the disk would not hold it.
        """
        found = await self.chosen(asked.experiment, asked.overrides)
        self._check_room(found)
        position = self.queue.add(asked)
        self.condition.change()
        self.log.info("run submitted", run=asked.id, operator=asked.operator)
        return position

    def new_entry(
        self,
        *,
        experiment: str,
        name: str,
        notes: str,
        operator: str,
        overrides: dict[str, Any],
    ) -> Waiting:
        """An entry for the queue under a name and an id that nothing else has."""
        stem = experiment.removesuffix(".toml")
        file, run_id = new_file(self.bench.recordings, name or stem)
        return Waiting(run_id, file, name or stem, stem, operator, notes, overrides)

    def cancel(self, run_id: str) -> None:
        """Take a run out of the queue. ApiError where it plays already, or does not wait."""
        if self._active is not None and self._active.asked.id == run_id:
            raise ApiError(409, "playing", "that run plays already: stop it instead.")
        if self.queue.remove(run_id) is None:
            raise ApiError(
                404, "not-waiting", f"no run {run_id[:40]!r} waits: it was played, or removed."
            )
        self.condition.change()

    def stop(self, by: str) -> bool:
        """Stop the rig and hold the queue; whether the rig is known to stand already."""
        run = self._active
        playing = run is not None and self.condition.playing
        if run is not None and playing:
            run.ask_stop(by)
        self._replay = None
        self.condition.hold(f"stopped by {by}")
        if playing:
            self.condition.fire(Event.STOP_ASKED)
        self.log.warning("stop", by=by, state=self.condition.state)
        return self.condition.standing

    @property
    def arming(self) -> str:
        """What arming would do now, as an opaque word: another one where that is something else."""
        waiting, fault = self.queue.first(), self.condition.fault or {}
        what = [waiting.id if waiting else "", self.condition.held or "", *fault.values()]
        return sha256(json.dumps(what).encode()).hexdigest()[:ARMING_DIGITS]

    def arm(self, by: str, seen: str | None = None) -> None:
        """Clear a fault and let the queue go on.

        ApiError where `seen`, what whoever arms has looked at, is no longer so, and while the rig
        is being stopped.
        """
        if seen is not None and seen != self.arming:
            raise ApiError(
                409,
                "changed",
                "what waits, or why it is held, has changed since you looked. Nothing was armed: "
                "look again, then arm.",
            )
        self.condition.arm(by)

    def play_back(self, run_id: str, recording: Recording, speed: float, start_s: float) -> None:
        """Show a recording on the page. ApiError while the rig plays."""
        if self.condition.playing:
            raise ApiError(
                409, "playing", "the rig plays, and its page shows that. Replay when it stands."
            )
        self._replay = (run_id, speed, ReplaySource(recording, speed, start_s, self._now_ns))
        self.condition.change()

    def start_job(self, kind: Kind, run_id: str, recording: Path) -> Job:
        """Begin work on a recording. ApiError while it is being written, or where too many wait."""
        if self._active is not None and self._active.asked.id == run_id:
            raise ApiError(
                409, "playing", "that run plays, and its recording grows. Ask when it is over."
            )
        return self.jobs.start(kind, run_id, recording)

    def end_play_back(self) -> None:
        """Show nothing, or the rig again."""
        self._replay = None
        self.condition.change()

    # -- what viewers see ---------------------------------------------------------------------

    def source(self) -> Source | None:
        """The rows that the page shows now."""
        run = self._active
        if run is not None and run.link is not None and run.link.table is not None:
            return self._table_source(run)
        if self._replay is not None:
            return self._replay[2]
        return None

    def status(self) -> dict[str, Any]:
        """Everything that can change, as the API's Status."""
        run, replay, now = self._active, self._replay, self.condition
        return {
            "state": now.state.value,
            "held": now.held is not None,
            "held_reason": now.held or "",
            "holder": self._holder(),
            "run": runs.status_table(run) if run is not None else None,
            "queue": [
                {key: getattr(entry, key) for key in ("id", "name", "experiment", "operator")}
                for entry in self.queue
            ],
            "limits": self.bench.rig.limits.model_dump(),
            "fault": now.fault,
            "arming": self.arming,
            "bus_alive": run is None or not run.silent,
            "last": now.last,
            "replay": {"run": replay[0], "speed": replay[1]} if replay else None,
            "jobs": [asdict(job) for job in self.jobs.open],
        }

    def _holder(self) -> str:
        run = self._active
        if run is None:
            return ""
        return f"{run.asked.operator}, with {run.asked.name} ({run.asked.experiment})"

    def _table_source(self, run: ActiveRun) -> TableSource | None:
        link = run.link
        if link is None or link.table is None:
            return None
        if run.source is None:
            constant = run.job.rig.nominal.torque_constant_nm_per_a
            run.source = TableSource(link.table, constant)
        return run.source

    # -- how it goes on -----------------------------------------------------------------------

    async def _watch(self) -> None:
        """Look at the run, and start the next one, for as long as the daemon lives."""
        while True:
            try:
                await self._look()
            except Exception as error:  # nothing that it meets may end the watch
                self.log.error("unexpected", exc_info=error)
                self.stop("a fault of the daemon")
            await asyncio.sleep(WATCH_EVERY_S)

    async def _look(self) -> None:
        run = self._active
        if run is not None:
            self._look_at(run)
        elif (
            self.condition.state is State.IDLE and self.condition.held is None and not self._closing
        ):
            waiting = self.queue.first()
            if waiting is not None:
                await self._start(waiting)
        if self._replay is not None and self._replay[2].over:
            self.end_play_back()

    def _look_at(self, run: ActiveRun) -> None:
        table = run.link.table if run.link is not None else None
        if table is None:
            return
        slot = table.slot
        now_ns = self._now_ns()
        if slot != run.slot:
            run.slot, run.slot_since_ns = slot, now_ns
            run.silent = False
        if slot > 0:
            self.reachable = True
            self.condition.fire(Event.MOVED)
        if table.stop_asked or slot >= run.slots - 1:
            self.condition.fire(Event.STOP_ASKED)
        patience_ns = max(BUS_SILENT_S, 3.0 * run.job.experiment.period_s) * NS_PER_S
        if self.condition.state is State.RUNNING and now_ns - run.slot_since_ns > patience_ns:
            run.silent = True
            self.log.error("the bus process is silent", run=run.asked.id, slot=slot)
            self.stop("the silence of the bus process")

    async def _start(self, asked: Waiting) -> None:
        """Begin the run whose turn it is; what cannot begin is a fault, and the queue is held."""
        run = None
        try:
            found = await asyncio.to_thread(self._chosen, asked.experiment, asked.overrides)
            self._check_room(found)
            job = self._job(asked, found.experiment)
            run = await asyncio.to_thread(runs.prepare, self._runs / asked.id, asked, job)
            if (
                self.condition.held is not None
                or self._closing
                or self.queue.remove(asked.id) is None
            ):
                runs.discard(run.folder)  # stopped, or taken out of the queue, meanwhile
                return
            write_notes(job.out, Notes(asked.notes, (), asked.operator))
            self._active = run
            self._replay = None
            self.condition.fire(Event.STARTED)
            if self._rig_lock is None:
                self._rig_lock = take(self._rig_lock_path, Holder(self._holder()))
            await runs.launch(
                run, self._rig_lock.descriptor, lambda: self._spawn(self._finish(run))
            )
            self.log.info("run started", run=asked.id, operator=asked.operator)
        except Exception as error:  # an entry of another version may be anything
            begun = run is not None and run.end_runner()
            if not isinstance(error, BenchError | OSError):
                self.log.error("unexpected", exc_info=error)
            self._active = None
            runs.discard(self._runs / asked.id)
            self.condition.fire(Event.STARTED)
            self._drop(asked)
            self.condition.fail(
                f"{asked.name} could not begin: {error}",
                confirmed=self.bench.simulated or not begun,
            )

    def _check_room(self, found: Chosen) -> None:
        needed = recording_bytes(found.slots, self.bench.rig.samples_per_command)
        check_room(self.bench.recordings, needed)

    def _drop(self, asked: Waiting) -> None:
        """Take a run that cannot begin out of the queue, if the disk lets it."""
        try:
            self.queue.remove(asked.id)
        except RecordingError as error:
            self.log.error("queue", error=str(error))

    def _chosen(self, experiment: str, overrides: dict[str, Any]) -> Chosen:
        return chosen(self.bench, experiment, validated(Overrides, overrides, "the request"))

    def _job(self, asked: Waiting, experiment: Experiment) -> RunJob:
        config = self.bench.run
        return RunJob(
            id=asked.id,
            experiment=experiment,
            rig=self.bench.rig,
            out=self.bench.recordings / asked.file,
            simulated=self.bench.simulated,
            priority=config.priority,
            cpu=config.cpu,
            stop_alone_s=config.without_daemon_s if config.without_daemon == "stop" else None,
            facts=runs.run_facts(asked),
        )

    async def _finish(self, run: ActiveRun) -> None:
        """The runner is gone: find out how the run ended, and go on or be held."""
        end = End(UNKNOWN)
        try:
            end = await end_of(run, self.condition)
            if end.asked:
                self.reachable = False
            self._let_go_of(run)
            self.condition.tell(run.asked.id, end.result.sentence)
            self.log.info("run ended", run=run.asked.id, **asdict(end.result))
            await self.refresh()
            if not self._to_be_analysed(run, end.result):
                runs.discard(run.folder)
        except Exception as error:  # whatever it is, the run is over
            self.log.error("unexpected", exc_info=error)
        await self._conclude(run, end)
        run.ended.set()

    def _let_go_of(self, run: ActiveRun) -> None:
        """Close the link; the rig's lock that came with it stays ours."""
        if run.link is None:
            return
        if self._rig_lock is None and run.link.lock_descriptor is not None:
            self._rig_lock = Lock(self._rig_lock_path, run.link.lock_descriptor)
            run.link.lock_descriptor = None
        run.source = None
        run.link.close()
        run.link = None

    async def _conclude(self, run: ActiveRun, end: End) -> None:
        self._active, result = None, end.result
        if result.outcome in ("faulted", "cut"):
            self.condition.fail(result.sentence, confirmed=end.confirmed)
            return
        if result.outcome != "complete":
            self.condition.hold(result.sentence)
        if result.outcome == "nothing":
            self.condition.fire(Event.NOTHING)
            return
        self.condition.fire(Event.ENDED)
        if self.bench.run.analyse and not self._closing:
            self._spawn(self._analyse(run))
        else:
            self.condition.fire(Event.ANALYSED)

    async def _analyse(self, run: ActiveRun) -> None:
        """Analyse a run that has just ended; well or not, the next one may begin then."""
        try:
            await self._analyse_left(run)
        finally:
            self.condition.fire(Event.ANALYSED)

    async def _analyse_left(self, run: ActiveRun) -> None:
        """Analyse a run that is over, whenever it ended; its folder stays until that is done."""
        job = self.jobs.start("analyse", run.asked.id, run.job.out, own=True)
        job = await self.jobs.ended(job)
        if job.state in ("done", "failed"):
            runs.discard(run.folder)
            self.condition.tell_more(run.asked.id, f"Analysis: {job.sentence}")
            self.condition.change()

    def _to_be_analysed(self, run: ActiveRun, result: RunResult) -> bool:
        """Whether an analysis follows; by the next daemon, where this one ends before it is done.

        A full disk may have kept the result out of the folder: nobody could tell it from there.
        """
        wanted = self.bench.run.analyse and result.outcome in ("complete", "stopped")
        return wanted and runs.result_in(run.folder) is not None

    async def refresh(self) -> None:
        """Bring the catalogue up to date; where that cannot be (a full disk) it stays as it was."""
        try:
            await asyncio.to_thread(self.catalogue.refresh)
        except BenchError as error:
            self.log.error("catalogue", error=str(error))
        except Exception as error:  # a file must not keep a run from its end
            self.log.error("catalogue", exc_info=error)

    @property
    def _rig_lock_path(self) -> Any:
        if self.bench.simulated:
            return self.bench.state / "rig.lock"  # each run has a bus of its own
        return rig_lock_path(self.bench.rig.bus)

    def _spawn(self, work: Any) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._over)

    def _over(self, task: "asyncio.Task[None]") -> None:
        """A task of ours has ended; one that failed is a fault of the daemon, and stops the rig."""
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self.log.error("unexpected", exc_info=error)
            self.stop("a fault of the daemon")
