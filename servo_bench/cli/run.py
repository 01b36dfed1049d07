"""`servo-bench run`: play an experiment on a rig and record it."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from servo_bench.cli.progress import run_progress
from servo_bench.cli.stopping import asked_to_stop
from servo_bench.excitation.experiment import Experiment, load_experiment
from servo_bench.files import find
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.lock import holding_rig
from servo_bench.run.realtime import PRIORITY
from servo_bench.run.session import RunSummary
from servo_bench.run.session import run as run_session
from sim_rig.process import spawn

STOPPED_BY_OPERATOR = 130
"""The exit code of a run that was stopped before there was anything to keep."""


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("run")(run)


def run(
    experiment: Annotated[str, typer.Argument(help="Experiment file: experiments/paper.toml.")],
    *,
    out: Annotated[Path, typer.Option("-o", "--out", help="Recording to write (MCAP).")],
    rig: Annotated[
        str | None, typer.Option(help="Rig file, instead of the experiment's own.")
    ] = None,
    simulated: Annotated[
        bool,
        typer.Option("--simulated", help="Start a software rig for this run, on a bus of its own."),
    ] = False,
    port: Annotated[int | None, typer.Option(help="TCP port of the bus.")] = None,
    priority: Annotated[
        int, typer.Option(min=0, max=99, help="SCHED_FIFO priority of the bus loop; 0 for none.")
    ] = PRIORITY,
    cpu: Annotated[int | None, typer.Option(min=0, help="CPU to pin the bus loop to.")] = None,
) -> None:
    """Play an experiment on a rig and record it.

    The drive is enabled, the schedule is played once, and the drive is stopped and disabled,
    whatever happens. Ctrl-C and SIGTERM stop the rig and leave a readable recording.
    """
    plan = load_experiment(experiment)
    chosen = load_rig(rig or plan.rig, beside=find(experiment).parent)
    if port is not None:
        chosen = chosen.with_bus(port=port)
    console = Console(stderr=True, emoji=False)
    summary = play(plan, chosen, out, console, simulated=simulated, priority=priority, cpu=cpu)
    tell_summary(summary, console)
    if summary.played == 0:
        raise typer.Exit(STOPPED_BY_OPERATOR)


def play(
    plan: Experiment,
    rig: RigConfig,
    out: Path,
    console: Console,
    *,
    simulated: bool,
    priority: int = PRIORITY,
    cpu: int | None = None,
    who: str = "servo-bench run",
) -> RunSummary:
    """Run with a progress bar and signals heeded; with `simulated`, on a rig started for it.

    `who` is told to whoever wants the rig meanwhile. BusyError naming the holder where somebody
    else on this machine is master on the rig's bus.
    """
    with ExitStack() as stack:
        stop = stack.enter_context(asked_to_stop())
        if simulated:
            started = stack.enter_context(spawn(rig.on_a_free_port().simulation_settings()))
            rig = rig.as_simulated(**started.bus)
        stack.enter_context(holding_rig(rig.bus, who))
        progress = stack.enter_context(run_progress(console))
        return run_session(
            plan,
            rig,
            out,
            progress=progress,
            stop=stop,
            stopped_by=lambda: stop.by,
            priority=priority,
            cpu=cpu,
        )


def tell_summary(summary: RunSummary, console: Console) -> None:
    """Say in a few lines how the run ended."""
    for sentence in summary.sentences:
        console.print(f"note: {sentence}", markup=False, soft_wrap=True)
    if summary.played == 0:
        console.print("stopped before the first slot: nothing was recorded.")
        return
    ending = "stopped early" if summary.stopped_early else "complete"
    if summary.alignment:
        told = "; ".join(delay.words() for delay in summary.alignment)
        console.print(f"against the ask: {told}", markup=False, soft_wrap=True)
    console.print(
        f"{ending}: {summary.played} of {summary.slots} slots played, {summary.missed} missed; "
        f"the drive is stopped and disabled. Recording: {summary.path}",
        markup=False,
        soft_wrap=True,
    )
