"""The bus loop: plays a schedule into an axis, slot by slot, in a process of its own.

    python -m servo_bench.run.busloop PID     (the session of that PID starts it; a job on stdin)

Nothing else shares this interpreter: no analysis, no file, no web server. The job is one JSON
line; rows go into the slot table; what is not a row goes to stdout as JSON lines. In each slot:

    wait for the deadline -> take what is late -> check limits -> command (RPDO, SYNC)
    -> take answers until all are there, or the next deadline is near

A slot whose time has passed is skipped and said, never made up. The chip index follows the slot.
Where the angles are sampled several times per command the loop turns once per sample, a *tick*: the
first of a slot commands, the others ask only. A slot whose first tick was skipped has no row, and
the command before it is held to its end.
Before anything is opened the process forks its supervisor, without which it plays nothing.
"""

import json
import logging
import os
import signal
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from types import FrameType
from typing import Any

from drivers.axis import Axis, Sample, WireEvent
from drivers.errors import StopAskedError
from servo_bench.clock import NS_PER_S, Clock, monotonic_ns
from servo_bench.devices import DriveConfig
from servo_bench.errors import BenchError, ConfigError, LimitError, WireError, gathered
from servo_bench.excitation.experiment import Experiment, Schedule, experiment_from_table
from servo_bench.rig import Limits, RigConfig, rig_from_table
from servo_bench.run.axes import open_axis
from servo_bench.run.limits import Guard, check_missed
from servo_bench.run.pace import Pace, pace_of
from servo_bench.run.realtime import PRIORITY, follow_parent, make_punctual
from servo_bench.run.rows import write_answer, write_fast
from servo_bench.run.supervisor import check_watched, start
from servo_bench.run.table import SlotTable, Stage

SETTLE_S = 0.5
"""For the last answers, in which the motor is told to stand."""
Tell = Callable[..., None]


@dataclass(frozen=True, slots=True)
class Job:
    """What the session hands over."""

    experiment: Experiment
    rig: RigConfig
    descriptor: int
    priority: int = PRIORITY
    cpu: int | None = None

    @classmethod
    def from_line(cls, line: str) -> "Job":
        """Read a job from its JSON line."""
        table: Mapping[str, Any] = json.loads(line)
        return cls(
            experiment=experiment_from_table(table["experiment"], "the session's job"),
            rig=rig_from_table(table["rig"], "the session's job"),
            descriptor=table["descriptor"],
            priority=table["priority"],
            cpu=table["cpu"],
        )

    def line(self) -> str:
        """The job as one JSON line."""
        return json.dumps(
            {
                "experiment": self.experiment.model_dump(mode="json"),
                "rig": self.rig.model_dump(mode="json"),
                "descriptor": self.descriptor,
                "priority": self.priority,
                "cpu": self.cpu,
            }
        )


def tell(kind: str, text: str, *, time_ns: int | None = None, **data: Any) -> None:
    """Say something to the session, if it still lives: one JSON line on stdout."""
    message = {"time_ns": time_ns or monotonic_ns(), "kind": kind, "text": text, "data": data}
    with suppress(BrokenPipeError):
        os.write(sys.stdout.fileno(), json.dumps(message).encode() + b"\n")


class Player:
    """Plays one schedule into one entered axis, writing rows; owns nothing but its counters."""

    def __init__(
        self,
        axis: Axis,
        schedule: Schedule,
        table: SlotTable,
        limits: Limits,
        clock: Clock,
        *,
        samples_per_slot: int = 1,
        sync_by_drive: bool = False,
    ) -> None:
        self._clock = clock
        self._axis = axis
        self._schedule = schedule
        self._table = table
        self._limits = limits
        self._parts = samples_per_slot
        self._tick_s = schedule.period_s / samples_per_slot
        self._sync_by_drive = sync_by_drive
        self._held_rad_s = 0.0
        self._reached = 0  # the tick to come
        self._open: list[int] = []  # ticks asked and not yet settled, in order

    def play(self, start_ns: int, tell: Tell) -> None:
        """Play every slot whose time comes; return early where the session asks to stop.

        Raises LimitError where a limit is left and WireError where the axis cannot be trusted, or
        where a supervisor that was there looks no more; ConfigError where it cannot be followed.
        """
        by_drive = self._sync_by_drive
        pace = pace_of(self._axis, self._clock, start_ns, self._tick_s, by_drive=by_drive)
        guard = Guard(self._limits, self._schedule.period_s, start_ns)
        try:
            self._play(pace, guard, tell)
        finally:  # a slot that was begun is recorded, with what came of it
            self._settle(self._axis.finish())
            self._tell(tell, ended=True)
            first = self._open[0] if self._open else self._reached
            self._table.done = max(self._table.done, -(-first // self._parts))

    def _play(self, pace: Pace, guard: Guard, tell: Tell) -> None:
        tick, ticks = 0, self._schedule.slots * self._parts
        while tick < ticks and not self._table.stop_asked:
            woken_ns = pace.wake(tick)
            self._table.beat_ns = woken_ns
            check_watched(self._table, woken_ns)
            self._settle(self._axis.samples(woken_ns), guard)
            due = min(pace.due(tick, woken_ns), ticks)
            if due > tick:
                self._skip(tick, due, tell)
                tick = due
                continue
            slot, part = divmod(tick, self._parts)
            if part == 0:
                self._held_rad_s = float(self._schedule.velocity_rad_s[slot])
            asked_ns = self._axis.command(self._held_rad_s, tick)
            self._write_ask(tick, asked_ns, pace.lateness_s(tick, woken_ns, asked_ns))
            self._settle(self._axis.samples(pace.until_ns(tick)), guard)
            self._heed(tell)
            tick += 1
        self._table.stage = Stage.RESTING
        self._rest(tick, pace, guard)

    def _rest(self, tick: int, pace: Pace, guard: Guard) -> None:
        """Wait for what has not been answered, the motor at velocity 0 from the next tick on: those
        that ask for it have no row."""
        self._settle(self._axis.samples(self._clock.now_ns()), guard)
        end_ns = self._clock.now_ns() + round(SETTLE_S * NS_PER_S)
        while self._open and self._clock.now_ns() < end_ns:
            self._table.beat_ns = woken_ns = pace.wake(tick)
            tick = pace.due(tick, woken_ns)
            asked_ns = self._axis.command(0.0, tick)
            pace.lateness_s(tick, woken_ns, asked_ns)
            self._settle(self._axis.samples(pace.until_ns(tick)), guard)
            tick += 1

    def _skip(self, tick: int, due: int, tell: Tell) -> None:
        first, end = -(-tick // self._parts), -(-due // self._parts)  # slots whose command is lost
        if end > first:
            self._table.missed += end - first
            text = f"{end - first} slot(s) from {first} on were missed"
            tell("slot skipped", text, slot=first, to=end)
        else:
            text = f"{due - tick} sample(s) of slot {tick // self._parts} were missed"
            tell("samples skipped", text, slot=tick // self._parts, samples=due - tick)
        self._reached = due
        if not self._open:
            self._table.done = due // self._parts
        check_missed(due - tick, due, self._tick_s, self._limits)

    def _write_ask(self, tick: int, asked_ns: int, lateness_s: float) -> None:
        slot, part = divmod(tick, self._parts)
        if part == 0:
            row = self._table.rows[slot]
            row["chip"] = self._schedule.chip[slot]
            row["phase"] = self._schedule.phase[slot]
            row["velocity_command_rad_s"] = self._schedule.velocity_rad_s[slot]
            row["asked_ns"] = asked_ns
            row["lateness_s"] = lateness_s
        if self._parts > 1:
            fast = self._table.fast[tick]
            fast["part"], fast["asked_ns"], fast["lateness_s"] = part, asked_ns, lateness_s
        self._table.slot = slot
        self._reached = tick + 1
        self._open.append(tick)

    def _settle(self, samples: Iterable[Sample], guard: Guard | None = None) -> None:
        """Record all of them; then LimitError for the first that left a limit."""
        breach: str | None = None
        for sample in samples:
            slot, part = divmod(sample.slot, self._parts)
            if sample.slot not in self._open:
                continue
            self._open.remove(sample.slot)
            if self._parts > 1:
                write_fast(self._table.fast[sample.slot], sample, slot)
                sample = replace(sample, slot=slot)  # noqa: PLW2901 - a tick's number is no slot's
            if part == 0:
                write_answer(self._table.rows[slot], sample)
            if sample.drive_temperature_c is not None:
                self._table.temperature_c = sample.drive_temperature_c
            first = self._open[0] if self._open else self._reached
            self._table.done = first // self._parts
            if guard is not None and part == 0:
                breach = breach or guard.breach(sample)
        if breach:
            raise LimitError(
                f"{breach}: the rig was stopped. Before playing again look at the recording, where "
                "one is kept; if the limit is too tight, raise it in the rig's [limits]."
            )

    def _heed(self, tell: Tell) -> None:
        for event in self._tell(tell):
            if event.fatal:
                raise WireError(f"{event.text} The rig was stopped in slot {self._table.slot}.")

    def _tell(self, tell: Tell, *, ended: bool = False) -> Sequence[WireEvent]:
        """Tell all of them; what comes after a run's end has not ended it, and is not fatal."""
        events = self._axis.events()
        for event in events:
            fatal = event.fatal and not ended
            tell(event.kind, event.text, time_ns=event.time_ns, fatal=fatal)
        return events


def player_for(
    rig: RigConfig, axis: Axis, schedule: Schedule, table: SlotTable, clock: Clock
) -> Player:
    """The player of a rig, as its file has limits and SYNC."""
    by_drive = isinstance(rig.drive, DriveConfig) and rig.drive.sync == "drive"
    return Player(
        axis,
        schedule,
        table,
        rig.limits,
        clock,
        samples_per_slot=rig.samples_per_command,
        sync_by_drive=by_drive,
    )


def run_job(job: Job, table: SlotTable) -> None:
    """Enable the rig, play, stop it. Raises BenchError; the axis is left stopped either way.

    A stop that is asked before the drive is enabled leaves it as it is.
    """
    schedule = job.experiment.schedule()
    if job.cpu is not None:
        try:
            os.sched_setaffinity(0, {job.cpu})
        except (OSError, OverflowError, ValueError) as error:
            raise ConfigError(
                f"cpu = {job.cpu}: the bus loop cannot be pinned there ({error}). This process may "
                f"use {sorted(os.sched_getaffinity(0))}. Name one of these."
            ) from error
    for sentence in make_punctual(job.priority):
        tell("not punctual", sentence)

    def asked_while_enabling() -> bool:
        """The axis asks again and again: the supervisor sees that enabling goes on."""
        table.beat_ns = monotonic_ns()
        return table.stop_asked

    table.stage = Stage.ENABLING
    axis: Axis | None = None
    try:
        if table.stop_asked:
            raise StopAskedError
        with (
            gathered(),
            (axis := open_axis(job.rig, job.experiment.period_s, asked_while_enabling)),
        ):
            # the next period already: a drive that watches SYNC allows no pause after enabling
            start_ns = monotonic_ns() + round(job.experiment.period_s * NS_PER_S)
            tell("playing", "the drive is enabled", start_ns=start_ns)
            table.beat_ns = monotonic_ns()
            table.stage = Stage.PLAYING
            try:
                player_for(job.rig, axis, schedule, table, Clock()).play(start_ns, tell)
            finally:
                table.stage = Stage.STOPPING
            asked = table.stop_asked
            tell("stopping", "the last slot was played" if not asked else "asked to stop")
    except StopAskedError as asked_before:
        tell("stopping", " ".join([str(asked_before), *getattr(asked_before, "__notes__", ())]))
    finally:
        stopped = axis is None or not axis.may_be_powered
        table.stage = Stage.OVER if stopped else Stage.UNCONFIRMED


def main(session_pid: int) -> int:
    """Entry point of the process: 0 when the rig was played and stopped, 1 when it was not."""
    logging.getLogger("can").setLevel(logging.CRITICAL)  # what python-can and canopen log, our
    logging.getLogger("canopen").setLevel(logging.CRITICAL)  # errors and events say in full
    if not follow_parent(signal.SIGTERM, session_pid):
        return 1  # nobody would watch or record what moves
    job = Job.from_line(sys.stdin.readline())
    slots, samples = job.experiment.schedule().slots, job.rig.samples_per_command
    with SlotTable(job.descriptor, slots, samples) as table:

        def stop(number: int, frame: FrameType | None) -> None:  # noqa: ARG001
            table.ask_stop()

        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the session decides, and asks by the table
        signal.signal(signal.SIGTERM, stop)
        try:
            start(job.rig, job.experiment.period_s, table, job.priority, tell)
            run_job(job, table)
        except BenchError as error:
            tell("error", str(error), error=type(error).__name__)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
