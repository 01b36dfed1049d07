"""`servo-bench demo`: the whole chain in a minute, on the software rig over its real wire."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from servo_bench.cli.analyse import analyse
from servo_bench.cli.output import new_folder
from servo_bench.cli.run import STOPPED_BY_OPERATOR, play, tell_summary
from servo_bench.excitation.experiment import load_experiment
from servo_bench.rig import load_rig

EXPERIMENT = "experiments/demo.toml"


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("demo")(demo)


def demo(
    out: Annotated[
        Path, typer.Option("-o", "--out", help="Folder for recording, report, and figures.")
    ] = Path("servo-bench-demo"),
) -> None:
    """Start the software rig, run a 44 s experiment on its wire, analyse it, write the report."""
    console = Console(stderr=True, emoji=False)
    plan = load_experiment(EXPERIMENT)
    new_folder(out)
    stem = datetime.now(UTC).strftime("%Y%m%d-%H%M%S")
    recording = out / f"{stem}.mcap"
    console.print(
        f"playing {plan.identification.polynomial} (octal) at {plan.period_s * 1e3:g} ms for "
        f"{plan.schedule().duration_s:.0f} s into a software rig over CANopen"
    )
    summary = play(plan, load_rig(plan.rig), recording, console, simulated=True)
    tell_summary(summary, console)
    if summary.stopped_early:
        raise typer.Exit(STOPPED_BY_OPERATOR)
    analyse(recording, report=recording.with_suffix(".html"), json=recording.with_suffix(".json"))
