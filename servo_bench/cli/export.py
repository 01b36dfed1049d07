"""`servo-bench export`: a recording as a file for another program."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from servo_bench.foreign.exporting import Kind
from servo_bench.foreign.exporting import export as write_export
from servo_bench.recording.mcap_file import load


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("export")(export)


def export(
    recording: Annotated[Path, typer.Argument(help="A recording (MCAP).")],
    *,
    to: Annotated[Kind, typer.Option("--to", help="The format.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write.")],
    fast: Annotated[
        bool, typer.Option("--fast", help="The several samples of each command instead.")
    ] = False,
) -> None:
    """Write every channel of a recording, with units in the columns' names."""
    loaded = load(recording)
    write_export(loaded, out, to, fast=fast)
    rows = len(loaded.fast["slot"]) if fast else len(loaded)
    channels = loaded.fast if fast else loaded.channels
    Console(stderr=True).print(
        f"{rows} rows of {len(channels)} channels are in {out}.",
        markup=False,
        soft_wrap=True,
    )
