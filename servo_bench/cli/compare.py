"""`servo-bench compare A B`: has the rig changed between two recordings?"""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from servo_bench.cli.output import check_outputs, write_json
from servo_bench.recording.mcap_file import load
from servo_bench.replay.change import Change
from servo_bench.replay.compare import Comparison
from servo_bench.replay.compare import compare as compare_recordings


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("compare")(compare)


def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="The earlier recording (MCAP).")],
    second: Annotated[Path, typer.Argument(metavar="B", help="The later recording (MCAP).")],
    *,
    json: Annotated[
        Path | None, typer.Option(help="Write the comparison, in SI units, to this file.")
    ] = None,
) -> None:
    """Compare two recordings: kernels, noise, and the rig's numbers, with standard errors.

    Says what has changed, by how much, and in which block; and what chance explains.
    """
    check_outputs(json)
    found = compare_recordings(load(first), load(second))
    if json is not None:
        write_json(json, found.numbers())
    _show(found)


def _show(found: Comparison) -> None:
    console = Console()
    table = Table("number", "A", "B", "difference, 95 %", "unit", "block", "", show_edge=False)
    for change in (*found.parameters, *found.noise):
        table.add_row(*_row(change), "[bold red]changed[/]" if found.is_change(change) else "")
    console.print(table)
    figures = Table("figure", "A", "B", show_edge=False)
    for name, (a, b) in found.figures.items():
        figures.add_row(name, _short(a), _short(b))
    console.print(figures)
    for sentence in found.sentences():
        console.print(escape(sentence), soft_wrap=True)


def _row(change: Change) -> tuple[str, ...]:
    factor, unit = change.shown
    half = factor * (change.interval()[1] - change.interval()[0]) / 2.0
    return (
        *(change.label, _short(factor * change.a), _short(factor * change.b)),
        f"{factor * change.difference:+.3g} ± {half:.2g}",
        *(unit, change.where),
    )


def _short(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else "-" if value is None else str(value)
