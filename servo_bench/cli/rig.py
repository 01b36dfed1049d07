"""`servo-bench rig`: the software rig, on its wire, until it is stopped."""

from typing import Annotated

import typer
from rich.console import Console

from servo_bench.cli.stopping import asked_to_stop
from servo_bench.rig import load_rig
from sim_rig.counter import orders as counter_orders
from sim_rig.faults.catalogue import KINDS
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
    fault: Annotated[
        list[str] | None,
        typer.Option(help="A fault to order, e.g. 'bus-off at=100 for_ms=500'. Repeatable."),
    ] = None,
    list_faults: Annotated[
        bool, typer.Option("--list-faults", help="Print the faults that can be ordered, and end.")
    ] = False,
) -> None:
    """Start the software rig: drive and encoder on a bus, standing in for the hardware.

    It plays the rig's nominal model until Ctrl-C or SIGTERM.
    """
    if list_faults:
        _print_faults()
        return
    chosen = load_rig(config).with_faults(*(fault or ()))
    if port is not None:
        chosen = chosen.with_bus(port=port)
    console = Console(stderr=True, emoji=False)

    def ready(where: dict[str, object]) -> None:
        place = " ".join(f"{key}={value}" for key, value in where.items())
        console.print(
            f"rig '{chosen.name}' is on the bus: {place}. Ctrl-C ends it.",
            markup=False,
            soft_wrap=True,
        )

    with asked_to_stop() as stop:
        serve(chosen.simulation_settings(), ready=ready, stop=stop)


def _print_faults() -> None:
    console = Console(markup=False, highlight=False, soft_wrap=True)
    for name, kind in KINDS.items():
        values = " ".join(f"{key}={value}" for key, value in kind.defaults.items())
        console.print(f"{name} {values}\n    {kind.text}")
    for kind_name, text in counter_orders.KINDS.items():
        order = counter_orders.default(kind_name)
        told = " ".join(f"{it}={getattr(order, it)}" for it in counter_orders.names_of(kind_name))
        console.print(f"{kind_name} {told}\n    {text}")
