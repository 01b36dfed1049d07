"""How a run ended: what its runner said, else what is left of it, and whether the rig stands.

A runner that is gone may have left its bus process playing: nothing is said of the end before that
is gone too. After an end that was none of a run's own the drive itself is asked.
"""

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from servo_bench.daemon import active as runs
from servo_bench.daemon.active import ActiveRun
from servo_bench.daemon.condition import Condition
from servo_bench.daemon.job import RunJob, RunResult
from servo_bench.daemon.machine import Event
from servo_bench.daemon.processes import wait_for_bus_processes
from servo_bench.run.limits import STOP_GRACE_S

if TYPE_CHECKING:
    from servo_bench.daemon.aftermath import Standing

UNKNOWN = RunResult("faulted", "how the run ended could not be found out: look at the rig.")


class End(NamedTuple):
    """How a run ended, whether the rig is known to stand, and whether the drive was asked that."""

    result: RunResult
    confirmed: bool = False
    asked: bool = False


async def end_of(run: ActiveRun, condition: Condition) -> End:
    """The end of a run whose runner is gone; no process of it lives when that is known.

    The queue is held before anything that takes time.
    """
    result = run.result()
    pid = run.runner_pid
    if result is None and pid is not None:
        condition.hold("the run's process died")
        condition.fire(Event.STOP_ASKED)
        await asyncio.to_thread(wait_for_bus_processes, pid, stop_takes_s(run))
        result = run.result()
    end = End(result or runs.without_a_word(run), confirmed=True)
    if end.result.outcome in ("faulted", "cut"):
        run.silent = True
        condition.hold("a fault")
        condition.fire(Event.STOP_ASKED)
        end = await _with_standing(run, end.result)
    if run.process is not None:
        await run.process.wait()
    return end


def stop_takes_s(run: ActiveRun) -> float:
    """How long a rig may take to stand, from the word that stops it."""
    drive = run.job.rig.drive
    return 2.0 * STOP_GRACE_S + drive.enable_timeout_s + drive.stop_timeout_s


async def _with_standing(run: ActiveRun, result: RunResult) -> End:
    """The result with what the drive itself says after a run that ended badly."""
    if run.job.simulated:
        return End(result, confirmed=True)  # its rig has ended with it
    if result.error not in ("", "WireError"):
        return End(result)
    said = await asyncio.to_thread(_standing, run.job)
    words = f"{result.sentence} {said.sentence}".strip()
    return End(replace(result, sentence=words), confirmed=said.confirmed, asked=True)


def _standing(job: RunJob) -> "Standing":
    """What the drive says about itself after a run; takes seconds."""
    from servo_bench.daemon.aftermath import ask_standing  # noqa: PLC0415 - all drivers

    return ask_standing(job.rig, job.experiment.period_s)
