"""`servo-bench rig`: the software rig, on its wire, until it is stopped."""

from typing import Annotated

import typer
from rich.console import Console

from servo_bench.cli.stopping import asked_to_stop
from servo_bench.rig import load_rig
from sim_rig.process import serve

DEFAULT_RIG = "rigs/paper.toml"


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("rig")(rig)


def rig(
    config: Annotated[
        str, typer.Option("--config", help="Rig file; shipped ones are found by name.")
    ] = DEFAULT_RIG,
    port: Annotated[
        int | None, typer.Option(help="TCP port of the embedded bus, instead of the file's.")
    ] = None,
) -> None:
    """Start the software rig: drive and encoder on a bus, standing in for the hardware.

    It plays the rig's nominal model until Ctrl-C or SIGTERM.
    """
    chosen = load_rig(config)
    if port is not None:
        chosen = chosen.with_bus(port=port)
    console = Console(stderr=True)

    def ready(where: dict[str, object]) -> None:
        place = " ".join(f"{key}={value}" for key, value in where.items())
        console.print(f"rig '{chosen.name}' is on the bus: {place}. Ctrl-C ends it.")

    with asked_to_stop() as stop:
        serve(chosen.simulation_settings(), ready=ready, stop=stop)
