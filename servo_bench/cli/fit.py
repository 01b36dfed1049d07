"""`servo-bench fit`: chosen numbers of the rig's model, fitted to a recording."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from servo_bench.cli.output import check_outputs, write_json, write_text
from servo_bench.diagnosis.comparing.comparison import Choice
from servo_bench.diagnosis.fitting.fit import Fit
from servo_bench.diagnosis.fitting.fit import fit as fit_recording
from servo_bench.diagnosis.fitting.foreign_start import starting_model
from servo_bench.diagnosis.fitting.model_file import load_model, model_text
from servo_bench.diagnosis.fitting.solver import Progress as Where
from servo_bench.diagnosis.judging.excitations import check_apart
from servo_bench.errors import ConfigError, FitError
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import Recording
from servo_bench.rig import load_rig
from sim_rig.model import Model


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("fit")(fit)


def fit(
    recording: Annotated[Path, typer.Argument(help="The recording (MCAP).")],
    *,
    free: Annotated[
        str,
        typer.Option(help="What to fit, with commas: J,K_T,K_P,K_I,gap,coulomb.torque_nm ..."),
    ],
    rig: Annotated[
        Path | None,
        typer.Option(help="The rig, for its model; else the recording's."),
    ] = None,
    model: Annotated[
        Path | None, typer.Option(help="Start from this model (TOML: nominal, effects.NAME).")
    ] = None,
    held_out: Annotated[
        Path | None, typer.Option(help="Judge on this recording instead of the validation.")
    ] = None,
    block: Annotated[
        Choice, typer.Option(help="The block to fit; auto: what the channels allow.")
    ] = "auto",
    window_s: Annotated[
        float | None,
        typer.Option(help="Windows that start from the measured state; mechanics: 1 s."),
    ] = None,
    prior: Annotated[
        bool, typer.Option("--prior", help="Count the usual ranges as one observation each.")
    ] = False,
    json: Annotated[
        Path | None, typer.Option(help="Write the figures, in SI units, to this file.")
    ] = None,
    model_out: Annotated[
        Path | None, typer.Option(help="Write the fitted model (TOML) to this file.")
    ] = None,
) -> None:
    """Fit numbers of the rig's model to a recording, with standard errors.

    Says which of them the recording cannot tell apart, and what the fit gains on data that it
    never saw. Exit code 7 where the search failed; the figures are written all the same.
    """
    check_outputs(json, model_out)
    loaded = load(recording)
    start = _start(loaded, rig, model)
    other = load(held_out) if held_out is not None else None
    check_apart([loaded], other)
    console = Console(stderr=True)
    with _progress(console) as report:
        found = fit_recording(
            loaded,
            start,
            free.split(","),
            block=block,
            window_s=window_s,
            prior=prior,
            held_out=other,
            report=report,
        )
    _show(found)
    if json is not None:
        write_json(json, {**found.numbers(), "nominal": asdict(found.model.nominal)})
    if model_out is not None:
        write_text(model_out, model_text(found.model))
    for path in (json, model_out):
        if path is not None:
            Console().print(f"written: {escape(str(path))}", soft_wrap=True)
    if not found.converged:
        raise FitError(found.reason)


def _start(recording: Recording, rig: Path | None, model: Path | None) -> Model:
    if rig is not None and model is not None:
        raise ConfigError("--rig and --model are given both: a model has its own nominal values.")
    if model is not None:
        return load_model(model)
    if rig is not None:
        return load_rig(rig).model()
    if recording.rig is not None:
        return recording.rig.model()
    return starting_model(recording)


@contextmanager
def _progress(console: Console) -> Iterator[Callable[[Where], None]]:
    """A bar: each stage's iterations halve what is left of it, since none knows how many come."""
    bar = Progress(
        TextColumn("{task.description:<12}"),
        BarColumn(),
        TextColumn("iteration {task.fields[iteration]}, error {task.fields[error]:.3g} floors"),
        TimeElapsedColumn(),
        console=console,
    )
    task = bar.add_task("fitting", total=1.0, iteration=0, error=0.0)
    began: dict[int, int] = {}

    def report(where: Where) -> None:
        bar.start()
        since = where.iteration - began.setdefault(where.stage, where.iteration - 1)
        bar.update(
            task,
            description=f"stage {where.stage} of {where.stages}",
            completed=(where.stage - 0.5**since) / where.stages,
            iteration=where.iteration,
            error=where.cost**0.5,
        )

    try:
        yield report
    finally:
        bar.stop()


def _show(found: Fit) -> None:
    console = Console()
    values = Table("free", "before", "fitted", "standard error", "unit", show_edge=False)
    for e in found.estimates:
        values.add_row(
            *(e.symbol, f"{e.before:.6g}", f"[bold]{e.value:.6g}[/]"),
            *(f"{e.standard_error:.2g}", e.unit),
        )
    console.print(values)
    errors = Table("rms error", "unit", show_edge=False)
    for column in ("seen, before", "after", "held out, before", "after", "noise"):
        errors.add_column(column, justify="right")
    for s in found.signals:
        numbers = (s.seen_before, s.seen_after, s.held_out_before, s.held_out_after, s.floor)
        errors.add_row(s.name, s.unit, *(f"{number:.4g}" for number in numbers))
    console.print(errors)
    window = f"windows of {found.window_s:g} s" if found.window_s else "whole"
    console.print(f"{found.block}, {window}: {found.iterations} iterations")
    for note in found.notes:
        console.print(f"[yellow]note:[/] {escape(note)}", soft_wrap=True)
