"""`servo-bench diagnose`: what the simulation of a rig gets wrong, and why."""

import json as json_module
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from servo_bench.cli.output import check_outputs, write_json, write_text
from servo_bench.diagnosis.concluding import conclude
from servo_bench.diagnosis.fitting.model_file import load_model, model_text
from servo_bench.diagnosis.judging.extended import extended_rig, found_model, rig_text
from servo_bench.diagnosis.judging.undecided import check_effects
from servo_bench.diagnosis.judging.verdict import Cause, ErrorFigures, Verdict
from servo_bench.errors import ConfigError
from servo_bench.recording.mcap_file import load
from servo_bench.report.diagnosis_page import diagnosis_report
from servo_bench.rig import load_rig


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("diagnose")(diagnose)


def diagnose(
    recordings: Annotated[
        list[Path] | None, typer.Argument(metavar="REC", help="Recordings (MCAP) of one rig.")
    ] = None,
    *,
    holdout: Annotated[
        Path | None, typer.Option(help="Measure the gain on this recording, which no fit sees.")
    ] = None,
    rig: Annotated[
        Path | None, typer.Option(help="The rig that is believed; else the recording's.")
    ] = None,
    model: Annotated[
        Path | None, typer.Option(help="The model that is believed (TOML: nominal, effects.NAME).")
    ] = None,
    without: Annotated[
        list[str] | None, typer.Option(help="Leave this effect out of the catalogue. Repeatable.")
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option(help="Try nothing but this effect. Repeatable.")
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write the verdict to this file.")] = None,
    report: Annotated[
        Path | None, typer.Option(help="Write the page, one HTML file, to this file.")
    ] = None,
    rig_out: Annotated[
        Path | None, typer.Option(help="Write the rig with the verdict's model to this file.")
    ] = None,
    model_out: Annotated[
        Path | None, typer.Option(help="Write the verdict's model (TOML) to this file.")
    ] = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the verdict's JSON schema, and end.")
    ] = False,
) -> None:
    """Say what the simulation of a rig gets wrong, name the cause, and measure what mending gains.

    The verdict is "named", "none", or "unknown"; each ends with exit code 0.
    """
    if schema:
        Console(soft_wrap=True, markup=False, highlight=False).print(
            json_module.dumps(Verdict.model_json_schema(), indent=2)
        )
        return
    if not recordings:
        raise ConfigError("no recording is given: name one or more MCAP files, or --schema.")
    if rig is not None and model is not None:
        raise ConfigError(
            "--rig and --model are given both, and each has nominal values of its own: give one."
        )
    check_outputs(json, report, rig_out, model_out)
    left_out, alone = _names(without), _names(only)
    check_effects(left_out, alone)
    loaded = [load(path) for path in recordings]
    held_out = load(holdout) if holdout is not None else None
    given = load_rig(rig) if rig is not None else None
    config = given if given is not None else loaded[0].rig
    if rig_out is not None and config is None:
        raise ConfigError(
            "--rig-out extends a rig, and the recording has none: give --rig, or write the model "
            "alone with --model-out."
        )
    believed = load_model(model) if model is not None else None
    with _progress() as told:
        found = conclude(
            loaded,
            rig=given,
            model=believed,
            held_out=held_out,
            without=left_out,
            only=alone,
            report=told,
        )
    if json is not None:
        write_json(json, found.verdict.numbers())
    if report is not None:
        write_text(report, diagnosis_report(*found, loaded[0]))
    if config is not None:
        rig_of = partial(extended_rig, config)
        _write_model(rig_out, found.verdict, lambda verdict: rig_text(rig_of(verdict)))
    _write_model(model_out, found.verdict, lambda verdict: model_text(found_model(verdict)))
    _show(found.verdict)  # after what was to be written: a reader of it may go away
    for path in (json, report, rig_out, model_out):
        if path is not None and path.exists():
            Console().print(f"written: {escape(str(path))}", soft_wrap=True)


def _names(given: Sequence[str] | None) -> tuple[str, ...]:
    """Effects by name, with commas or one by one."""
    names = (name.strip() for item in given or () for name in item.split(","))
    return tuple(dict.fromkeys(name for name in names if name))


def _write_model(path: Path | None, verdict: Verdict, text: Callable[[Verdict], str]) -> None:
    if path is None:
        return
    if not verdict.nominal:
        Console(stderr=True).print(
            f"[yellow]note:[/] {escape(str(path))} is not written: nothing was fitted.",
            soft_wrap=True,
        )
        return
    write_text(path, text(verdict))


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """A line that says what is being done; lines one under another where it is no terminal."""
    console = Console(stderr=True, markup=False, highlight=False, soft_wrap=True)
    if not console.is_terminal:
        yield console.print
        return
    with console.status("reading") as line:
        yield line.update


def _show(verdict: Verdict) -> None:
    console = Console()
    console.print(f"[bold]{verdict.verdict}[/]: {escape(verdict.sentence)}", soft_wrap=True)
    if verdict.causes:
        table = Table("cause", "parameter", "value", "95 %", "unit", show_edge=False)
        table.add_column("confidence", justify="right")
        table.add_column("or")
        for cause in verdict.causes:
            for row in _rows(cause):
                table.add_row(*row)
        console.print(table)
    if verdict.error is not None:
        console.print(_held_out(verdict.error), soft_wrap=True)
    if verdict.signature is not None:
        console.print(escape(verdict.signature.words), soft_wrap=True)
    for word, sentences in (("note", verdict.notes), ("undecided", verdict.undecided)):
        for sentence in sentences:
            console.print(f"[yellow]{word}:[/] {escape(sentence)}", soft_wrap=True)
    if verdict.next_run:
        console.print(f"[bold]next:[/] {escape(verdict.next_run)}", soft_wrap=True)


def _held_out(error: ErrorFigures) -> str:
    without = error.without_causes
    alone = f"{without:.4g} without causes, " if without is not None else ""
    return (
        f"held out, {error.signal}: rms {error.before:.4g} before, {alone}{error.after:.4g} after, "
        f"noise {error.noise_floor:.2g} {error.unit}"
    )


def _rows(cause: Cause) -> Iterator[tuple[str, ...]]:
    first = (f"[bold]{cause.effect}[/]", f"{cause.confidence:.0%}", ", ".join(cause.ambiguous_with))
    for name, q in cause.parameters.items() or ():
        low, high = q.ci95
        between = "chosen" if q.is_chosen else f"{low:.4g} .. {high:.4g}"
        yield (first[0], name, f"{q.value:.4g}", between, q.unit, *first[1:])
        first = ("", "", "")
    if not cause.parameters:
        yield (first[0], "", "", "", "", *first[1:])
