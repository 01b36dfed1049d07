"""`servo-bench analyse`: a recording's Volterra kernels, and how well they predict."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from servo_bench.cli.output import check_outputs, write_json, write_text
from servo_bench.estimators.registry import ESTIMATORS
from servo_bench.estimators.study import Study, study
from servo_bench.kernels.analysis import Analysis
from servo_bench.kernels.analysis import analyse as analyse_recording
from servo_bench.recording.mcap_file import load
from servo_bench.report.distortion_words import distortion_sentences
from servo_bench.report.estimator_tables import estimator_rows, judged_words
from servo_bench.report.html import analysis_report
from servo_bench.report.wording import NOT_KNOWN, ceiling, percent


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("analyse")(analyse)


def analyse(
    recording: Annotated[Path, typer.Argument(help="The recording (MCAP).")],
    *,
    report: Annotated[
        Path | None, typer.Option(help="Write the report, one HTML file, to this file.")
    ] = None,
    json: Annotated[
        Path | None, typer.Option(help="Write the figures, in SI units, to this file.")
    ] = None,
    memory: Annotated[
        int | None,
        typer.Option(min=1, help="Memory of the kernels in samples, instead of the experiment's."),
    ] = None,
    polynomial: Annotated[
        str | None,
        typer.Option(help="The M-sequence's polynomial in octal, where the recording has none."),
    ] = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            help=f"Estimators, with commas between: {', '.join(ESTIMATORS)}. By default the "
            "paper's correlation and one that serves this sequence."
        ),
    ] = None,
) -> None:
    """Extract the Volterra kernels of a recording and judge them on its held-out validation.

    Prints the main figures; writes a report and the figures where asked to. Estimators beside the
    paper's are judged on the same validation, and against a grey box on inputs never played.
    """
    check_outputs(report, json)
    loaded = load(recording)
    analysis = analyse_recording(loaded, memory=memory, polynomial=polynomial)
    names = [name.strip() for name in estimator.split(",")] if estimator is not None else []
    found = study(loaded, analysis, names, memory)
    if json is not None:
        write_json(json, found.numbers())
    if report is not None:
        write_text(report, analysis_report(analysis, loaded, found))
    _show(analysis, found, report, json)


def _show(analysis: Analysis, found: Study, *written: Path | None) -> None:
    console = Console()
    validation = analysis.validation
    fresh = validation.velocity if validation else None
    table = Table("VAF of the load's velocity", show_edge=False, pad_edge=False)
    table.add_column("order 1", justify="right")
    table.add_column("orders 1 to 3", justify="right")
    table.add_row(
        "[bold]fresh (held out): this one counts[/]",
        percent(fresh.vaf_order1_percent) if fresh else NOT_KNOWN,
        f"[bold]{percent(fresh.vaf_order3_percent) if fresh else NOT_KNOWN}[/]",
    )
    same = analysis.identification
    table.add_row(
        "[dim]same period (used to identify)[/]",
        percent(same.vaf_order1_percent),
        percent(same.vaf_order3_percent),
    )
    table.add_row("noise ceiling", "", ceiling(analysis.noise_ceiling_percent))
    console.print(table)
    console.print(_estimators(found))
    for sentence in distortion_sentences(analysis):
        console.print(sentence, highlight=False, soft_wrap=True)
    quality = analysis.quality
    console.print(f"{quality.missed_slots} of {quality.slots} slots missed")
    for flag in analysis.flags:
        console.print(f"[yellow]note:[/] {escape(flag)}", soft_wrap=True)
    for path in written:
        if path is not None:
            console.print(f"written: {escape(str(path))}", soft_wrap=True)


def _estimators(found: Study) -> Table:
    table = Table(f"VAF by estimator, {judged_words()}", show_edge=False, pad_edge=False)
    table.add_column("fresh", justify="right")
    table.add_column("[dim]same period[/]", justify="right")
    for row in estimator_rows(found):
        name = f"[bold]{row.name}[/]" if row.best else row.name
        remark = f"\n[dim]{escape(row.remark)}[/]" if row.remark else ""
        table.add_row(name + remark, row.fresh, f"[dim]{row.same}[/]")
    return table
