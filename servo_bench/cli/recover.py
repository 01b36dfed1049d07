"""`servo-bench recover`: what a cut recording still holds, in a new file."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from servo_bench.errors import ConfigError
from servo_bench.recording.recover import recover as recover_file


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("recover")(recover)


def recover(
    file: Annotated[Path, typer.Argument(help="The recording that ends too early.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="New file; default NAME.recovered.mcap.")
    ] = None,
) -> None:
    """Write everything that a cut recording still holds into a new, complete file.

    The cut file is left as it is.
    """
    if not file.name:
        raise ConfigError(f"{file} is a folder: name the recording in it.")
    target = out or file.with_suffix(".recovered.mcap")
    found = recover_file(file, target)
    text = (
        f"{found.samples} samples ({found.seconds:.1f} s) and {found.events} events are in "
        f"{target}; {found.lost_bytes} bytes could not be read."
        if found.was_cut
        else f"{file} was complete already: all {found.samples} samples are in {target} too."
    )
    Console(stderr=True, emoji=False).print(text, markup=False, soft_wrap=True)
