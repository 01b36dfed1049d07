"""The run session: starts the bus loop, watches it, records what it sees, and ends it.

The session is the only party that writes the recording, and the loop the only one that talks to
the rig, until its supervisor has to stop the rig; nobody waits for another. Order of business on
every way out: the rig is stopped (by the loop or the supervisor, whatever happens here), the last
rows are written, only then is an error raised.
"""

import json
import os
import select
import signal
import subprocess
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from servo_bench import errors
from servo_bench.clock import NS_PER_S, monotonic_ns
from servo_bench.errors import BenchError, ConfigError, RecordingError, WireError
from servo_bench.excitation.experiment import Experiment, Phase, Schedule
from servo_bench.excitation.sequences import FieldSequence, FromRecording, InverseRepeat
from servo_bench.kernels.shifts import collision_free_memory
from servo_bench.recording.alignment import Delay, alignment
from servo_bench.recording.mcap_file import RecordingWriter
from servo_bench.recording.provenance import provenance
from servo_bench.recording.recording import Event
from servo_bench.rig import RigConfig
from servo_bench.run.axes import axis_settings
from servo_bench.run.busloop import Job
from servo_bench.run.command_line import bus_loop_command
from servo_bench.run.judge import KINDS
from servo_bench.run.limits import STOP_GRACE_S, check_schedule
from servo_bench.run.realtime import PRIORITY
from servo_bench.run.table import UNPLAYED, SlotTable

WRITE_EVERY_S = 0.1
STATUS_WINDOW_S = 2.0
KERNEL_ORDER = 3
OPERATOR = "the operator"
"""Who is said to have stopped a run where nobody knows better."""
NO_FACTS: Mapping[str, str] = MappingProxyType({})
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""The bus loop forks its supervisor, which a process of several threads must not do."""
Told = tuple[Event, bool]


@dataclass(frozen=True, slots=True)
class Status:
    """What the operator may see while the run plays."""

    slot: int
    slots: int
    phase: Phase
    seconds_left: float
    missed: int
    lateness_p50_s: float
    lateness_max_s: float


@dataclass(frozen=True, slots=True)
class RunSummary:
    """How a run ended."""

    path: Path
    slots: int
    played: int
    missed: int
    stopped_early: bool
    sentences: tuple[str, ...] = field(default=())
    alignment: tuple[Delay, ...] = ()


def run(
    experiment: Experiment,
    rig: RigConfig,
    out: Path,
    *,
    progress: Callable[[Status], None] = lambda _: None,
    stop: Callable[[], bool] = lambda: False,
    stopped_by: Callable[[], str] = lambda: OPERATOR,
    opened: Callable[[SlotTable], None] = lambda _: None,
    facts: Mapping[str, str] = NO_FACTS,
    priority: int = PRIORITY,
    cpu: int | None = None,
) -> RunSummary:
    """Play `experiment` on `rig` and record it to `out`.

    `stop` is asked about ten times a second; once it says yes the rig is stopped and the recording
    closed. `stopped_by` says for the record who wanted that, "" as long as it is not known.
    `opened` gets the slot table before anything is enabled: who keeps a duplicate of its descriptor
    can look on, and ask to stop within a slot. `facts` are added to the provenance. Raises
    ConfigError or LimitError before anything is enabled; WireError, DriveError, LimitError or
    RecordingError after, when the rig has been stopped and the recording closed. A run that ended
    before its first sample leaves no file.
    """
    schedule = experiment.schedule()
    check_memory(experiment)
    check_schedule(schedule, rig.limits)
    axis_settings(rig, experiment.period_s)  # a missing EDS is found before a file is opened
    with SlotTable.create(schedule.slots, rig.samples_per_command) as table:
        opened(table)
        known = {**provenance(), **facts}
        writer = RecordingWriter(out, experiment, rig, known, 1.0 / experiment.period_s)
        watch = _Watch(table, schedule, writer, progress)
        try:
            with writer:
                with _Loop(Job(experiment, rig, table.descriptor, priority, cpu)) as loop:
                    try:
                        watch.until_over(loop, stop, stopped_by)
                    except BaseException as failure:
                        watch.hear_out(loop, failure)
                        raise
                error = watch.what_ended_it(loop)
                delays = alignment(table.rows[table.rows["slot"] != UNPLAYED])
                watch.close(error, delays)
        finally:
            if watch.played == 0:
                out.unlink(missing_ok=True)
        if error is not None:
            raise error
        return RunSummary(
            path=out,
            slots=schedule.slots,
            played=watch.played,
            missed=table.missed,
            stopped_early=table.stop_asked,
            sentences=tuple(watch.sentences),
            alignment=delays,
        )


def check_memory(experiment: Experiment) -> None:
    """Raise ConfigError where the sequence cannot give kernels of the memory that is asked for."""
    if isinstance(experiment.identification, FieldSequence | FromRecording):
        return  # three or five levels, or anything: the rule is one of binary sequences
    polynomial = experiment.identification.polynomial
    mirrored = isinstance(experiment.identification, InverseRepeat)
    limit = collision_free_memory(polynomial, KERNEL_ORDER, inverse_repeat=mirrored)
    if experiment.memory > limit:
        raise ConfigError(
            f"memory = {experiment.memory} samples, but the cross-sections of {polynomial} collide "
            f"beyond {limit} (order {KERNEL_ORDER}). Lower memory to {limit}, or choose a "
            "polynomial of a higher degree. Nothing was enabled."
        )


class _Loop:
    """The bus loop's process: its job goes in, its events come out, and it never outlives us."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._unread = b""
        self._silent = False

    def __enter__(self) -> "_Loop":
        self.process = subprocess.Popen(
            bus_loop_command(os.getpid()),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=(self._job.descriptor,),
            env=os.environ | _ONE_THREAD,
            start_new_session=True,  # what a terminal sends (Ctrl-C, hang-up) is for the session
        )
        stdin, stdout = self.process.stdin, self.process.stdout
        if stdin is None or stdout is None:
            raise WireError("the bus process has no pipes: start it through the session.")
        self._stdout = stdout.fileno()
        os.set_blocking(self._stdout, False)
        with suppress(BrokenPipeError):  # its exit status will say why
            stdin.write(self._job.line().encode() + b"\n")
            stdin.close()
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(STOP_GRACE_S + self._job.rig.drive.stop_timeout_s)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        if self.process.stdout:
            self.process.stdout.close()

    def events(self, timeout_s: float) -> list[Told]:
        """What the loop and its supervisor have said, and whether it is an end, after waiting for
        at most `timeout_s`."""
        select.select([self._stdout], [], [], timeout_s)
        try:
            while data := os.read(self._stdout, 65536):
                self._unread += data
            self._silent = True
        except BlockingIOError:
            pass
        *lines, self._unread = self._unread.split(b"\n")
        return [_event(line) for line in lines]

    @property
    def stop_takes_s(self) -> float:
        """How long the loop may need to end, wherever it is asked: set up, enabling, or moving."""
        drive = self._job.rig.drive
        return STOP_GRACE_S + drive.enable_timeout_s + drive.stop_timeout_s

    @property
    def ended(self) -> bool:
        """Whether the loop's process has ended."""
        return self.process.poll() is not None

    @property
    def over(self) -> bool:
        """Whether it has ended and its supervisor, which has the same stdout, has too."""
        return self.ended and self._silent


def _past(begun_ns: int | None, patience_ns: int) -> bool:
    return begun_ns is not None and monotonic_ns() - begun_ns >= patience_ns


def _stop_event(asked_ns: int, by: str) -> Event:
    return Event(asked_ns, "stop asked", f"by {by}", {"by": by})


def _event(line: bytes) -> Told:
    message = json.loads(line)
    event = Event(message["time_ns"], message["kind"], message["text"], message["data"])
    return event, event.kind == "error"


class _Watch:
    """Moves rows and events from the loop to the recording, and keeps what ended the run."""

    def __init__(
        self,
        table: SlotTable,
        schedule: Schedule,
        writer: RecordingWriter,
        progress: Callable[[Status], None],
    ) -> None:
        self._table = table
        self._schedule = schedule
        self._writer = writer
        self._progress = progress
        self._samples_per_slot = max(1, table.fast.size // max(schedule.slots, 1))
        self._written = 0
        self._unwritten: deque[Event] = deque()
        self._ending: Event | None = None
        self._supervisors_stop = "has not said whether the drive stands: see that it does"
        self.played = 0
        self.sentences: list[str] = []

    def until_over(
        self, loop: _Loop, stop: Callable[[], bool], stopped_by: Callable[[], str]
    ) -> None:
        """Write and report until the loop's process has ended and everything is written.

        A loop that has been asked to stop and hangs, or a supervisor that outlives its loop, is
        waited for no longer than a stop can take. A stop is recorded at its time when it is known
        who asked: the word in shared memory may be seen before the name has come.
        """
        over = named = False
        patience_ns = round(loop.stop_takes_s * NS_PER_S)
        asked_ns: int | None = None
        ended_ns: int | None = None
        while not over and not _past(asked_ns, patience_ns) and not _past(ended_ns, patience_ns):
            over = loop.over  # asked first, so that the last pass sees all it left
            if ended_ns is None and loop.ended:
                ended_ns = monotonic_ns()
            self._listen(loop, over=over)
            while self._unwritten:
                self._writer.event(self._unwritten.popleft())
            status = self._status()  # taken first: what the operator sees is recorded by then
            self._write_rows()
            self._progress(status)
            if asked_ns is None and stop():
                asked_ns = monotonic_ns()
                self._table.ask_stop()
            if asked_ns is not None and not named and (by := stopped_by()):
                self._writer.event(_stop_event(asked_ns, by))
                named = True
        if asked_ns is not None and not named:
            self._writer.event(_stop_event(asked_ns, OPERATOR))

    def hear_out(self, loop: _Loop, error: BaseException) -> None:
        """Stop the rig, and wait for its end without writing, which may be what has failed; an end
        that is not a good one becomes a note of `error`."""
        patience_ns = round(loop.stop_takes_s * NS_PER_S)
        self._table.ask_stop()
        asked_ns = monotonic_ns()
        ended_ns: int | None = None
        over = False
        while not over and not _past(ended_ns or asked_ns, patience_ns):
            over = loop.over  # asked first, as above
            if ended_ns is None and loop.ended:
                ended_ns = monotonic_ns()
            self._listen(loop, over=over)
        if ended_ns is None:
            error.add_note(
                f"The bus process did not end within {loop.stop_takes_s:g} s of being asked to "
                "stop: see that the drive stands."
            )
        elif (end := self.what_ended_it(loop)) is not None:
            error.add_note(f"Of the rig: {end}")

    def _listen(self, loop: _Loop, *, over: bool) -> None:
        """Take what was said before any of it is written: a disk may refuse the first of it."""
        for event, is_end in loop.events(0.0 if over else WRITE_EVERY_S):
            self._unwritten.append(event)
            self._note(event, is_end=is_end)

    def _note(self, event: Event, *, is_end: bool) -> None:
        if is_end:
            self._ending = event
        elif event.kind == "not punctual":
            self.sentences.append(event.text)
        elif event.kind == "supervisor's stop":
            self._supervisors_stop = event.text.rstrip(".")

    def _write_rows(self) -> None:
        done, parts = self._table.done, self._samples_per_slot
        rows = self._table.rows[self._written : done]
        rows = rows[rows["slot"] != UNPLAYED]
        if parts > 1:  # first, so that the chunk that the samples close has them
            fast = self._table.fast[self._written * parts : done * parts]
            self._writer.fast(fast[fast["slot"] != UNPLAYED])
        if rows.size:
            self._writer.samples(rows)
        self.played += rows.size
        self._written = done

    def _status(self) -> Status:
        slot, period_s = self._table.slot, self._schedule.period_s
        lateness_s = self._recent_lateness_s(slot, round(STATUS_WINDOW_S / period_s))
        return Status(
            slot=slot,
            slots=self._schedule.slots,
            phase=Phase(int(self._schedule.phase[slot])),
            seconds_left=(self._schedule.slots - slot) * period_s,
            missed=self._table.missed,
            lateness_p50_s=float(np.median(lateness_s)),
            lateness_max_s=float(lateness_s.max()),
        )

    def _recent_lateness_s(self, slot: int, window: int) -> NDArray[np.float64]:
        recent: NDArray[np.float64] = self._table.rows["lateness_s"][max(0, slot - window) : slot]
        recent = recent[np.isfinite(recent)]
        return recent if recent.size else np.zeros(1)

    def what_ended_it(self, loop: _Loop) -> BenchError | None:
        """What the loop reported, or what its exit status means; None after a good run."""
        if self._ending is None:
            return self._unreported(loop.process.returncode)
        trip = self._table.trip
        unsaid = trip is None or trip.kind != "stop unconfirmed"
        more = "" if unsaid else f" The safety supervisor: {self._supervisors_stop}."
        return _error_class(self._ending)(f"{self._ending.text}{more}")

    def close(self, error: BenchError | None, delays: tuple[Delay, ...]) -> None:
        """Write the last words: what ended the run, where the loop has not said it, and when the
        samples were. A disk that refuses them hides no other end."""
        try:
            if error is not None and self._ending is None:
                data = {"error": type(error).__name__}
                self._writer.event(Event(monotonic_ns(), "error", str(error), data))
            self._writer.alignment(delays)
        except RecordingError as failure:
            if error is None:
                raise
            error.add_note(str(failure))

    def _unreported(self, status: int) -> BenchError | None:
        trip = self._table.trip
        if trip is not None:
            end = f" ({_exit_in_words(status)})" if trip.kind == "loop ended" else ""
            return KINDS.get(trip.kind, WireError)(
                f"{trip.text}{end} The safety supervisor: {self._supervisors_stop}."
            )
        if status != 0:
            return WireError(
                f"the bus process ended without a word ({_exit_in_words(status)}) in slot "
                f"{self._table.slot}. The drive stops by itself when it misses the master's "
                "heartbeat; check that it has, and look at this terminal for a traceback."
            )
        return None


def _error_class(event: Event) -> type[BenchError]:
    named = getattr(errors, str(event.data.get("error")), BenchError)
    return named if isinstance(named, type) and issubclass(named, BenchError) else BenchError


def _exit_in_words(status: int) -> str:
    return f"killed by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
