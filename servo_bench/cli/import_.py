"""`servo-bench import`: measured data from elsewhere become a recording."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from servo_bench.cli.output import check_outputs
from servo_bench.foreign.importing import read_foreign
from servo_bench.foreign.maps import load_map
from servo_bench.recording.blocks import blocks_of
from servo_bench.recording.measured_writer import save_measured
from servo_bench.recording.reader import duration_s
from servo_bench.recording.recording import Recording


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("import")(import_)


def import_(
    file: Annotated[Path, typer.Argument(help="CSV, MAT, NPZ, JSON or Parquet file.")],
    *,
    map_: Annotated[
        str,
        typer.Option("--map", help="What its columns are; shipped: maps/laas_cogging.toml ..."),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Recording to write (MCAP).")],
) -> None:
    """Turn measured data from elsewhere into a recording.

    The map names each column's role and unit. Times stay as irregular as they are, nothing is
    resampled, and whatever was dropped is said here and in the recording.
    """
    check_outputs(out)
    recording = read_foreign(file, load_map(map_))
    save_measured(recording, out)
    _tell(recording, out, Console(stderr=True))


def _tell(recording: Recording, out: Path, console: Console) -> None:
    for event in recording.events:
        console.print(f"note: {event.text}.", markup=False, soft_wrap=True)
    blocks = blocks_of(recording)
    for block in blocks:
        path = f"{', '.join(block.inputs)} -> {', '.join(block.outputs)}"
        console.print(f"{block.name}: {path}", markup=False, soft_wrap=True)
    if not blocks:
        console.print(
            "note: no block of the rig has both its input and its output among these channels."
        )
    console.print(
        f"{len(recording)} rows, {duration_s(recording):.1f} s, "
        f"{', '.join(recording.channels)}: {out}",
        markup=False,
        soft_wrap=True,
    )
