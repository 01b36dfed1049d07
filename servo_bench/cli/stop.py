"""`servo-bench stop`: stop the rig of a daemon, from any terminal of its machine."""

from typing import Annotated

import typer
from rich.console import Console

from servo_bench.cli.stopping import user
from servo_bench.daemon.stopping import reach_of, stop_rig


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("stop")(stop)


def stop(
    config: Annotated[
        str, typer.Option("--config", help="The bench's file, as the daemon was given it.")
    ] = "bench.toml",
) -> None:
    """Stop the rig and hold the daemon's queue; works even when the daemon has crashed.

    It is no emergency stop.
    """
    sentence = stop_rig(reach_of(config), f"{user()} at a terminal")
    Console(stderr=True, emoji=False).print(sentence, markup=False, soft_wrap=True)
