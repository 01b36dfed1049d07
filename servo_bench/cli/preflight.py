"""`servo-bench preflight`: what an experiment will do to a rig, before anything is enabled."""

from typing import Annotated

import typer
from rich.console import Console

from servo_bench.cli.findings import conclude, show
from servo_bench.excitation.experiment import load_experiment
from servo_bench.files import find
from servo_bench.rig import load_rig
from servo_bench.run.lock import holding_rig
from servo_bench.run.preflight import preflight as examine
from servo_bench.run.preflight_read import read_drive


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("preflight")(preflight)


def preflight(
    experiment: Annotated[str, typer.Argument(help="Experiment file: experiments/paper.toml.")],
    *,
    rig: Annotated[
        str | None, typer.Option(help="Rig file, instead of the experiment's own.")
    ] = None,
    read: Annotated[
        bool,
        typer.Option("--read", help="Ask the drive too: ratings, limits, ramps, gains."),
    ] = False,
    port: Annotated[int | None, typer.Option(help="TCP port of the bus.")] = None,
) -> None:
    """Say what an experiment will do to a rig: travel, current, heat, units, ramps, wire.

    Nothing is enabled and nothing is written. Exit code 1 where the run would be refused or trip.
    """
    plan = load_experiment(experiment)
    chosen = load_rig(rig or plan.rig, beside=find(experiment).parent)
    if port is not None:
        chosen = chosen.with_bus(port=port)
    console = Console(emoji=False)
    findings = examine(plan, chosen)
    show(console, findings)
    if read:
        with holding_rig(chosen.bus, "servo-bench preflight"):
            told = read_drive(plan, chosen)
        show(console, told)
        findings = findings + told
    conclude(console, findings, "nothing stands against this run.")
