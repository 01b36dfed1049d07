"""`servo-bench paper`: the paper's simulation, computed again."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from servo_bench.cli.output import check_outputs, write_json, write_text
from servo_bench.kernels.paper_simulation import PaperResult, simulate_paper
from servo_bench.report.html import paper_report
from servo_bench.report.wording import percent


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("paper")(paper)


def paper(
    report: Annotated[
        Path | None, typer.Option(help="Write figures 2 to 4, one HTML file, to this file.")
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write the figures to this file.")] = None,
) -> None:
    """Compute the paper's simulation again: a second-order system with backlash, and its kernels.

    Needs no rig. The fresh figures are against random binary input that no fit saw.
    """
    check_outputs(report, json)
    result = simulate_paper()
    if json is not None:
        write_json(json, result.numbers())
    if report is not None:
        write_text(report, paper_report(result))
    _show(result, report, json)


def _show(result: PaperResult, *written: Path | None) -> None:
    console = Console()
    table = Table("VAF, G(s)", show_edge=False, pad_edge=False)
    columns = {
        "order1_fresh": "fresh, order 1",
        "order3_fresh": "fresh, to order 3",
        "order3_same": "same, to order 3",
    }
    for name in columns.values():
        table.add_column(name, justify="right")
    for name, plant in (("with the zero (14)", result.zero), ("without the zero", result.no_zero)):
        figures = plant.numbers()
        table.add_row(name, *(percent(figures[column]) for column in columns))
    console.print(table)
    for path in written:
        if path is not None:
            console.print(f"written: {escape(str(path))}", soft_wrap=True)
