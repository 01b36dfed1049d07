"""`servo-bench check PLAN.toml`: an acceptance plan, judged: pass or fail."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from servo_bench.check.judge import Judgement, judge
from servo_bench.check.junit import error_xml, judgement_xml
from servo_bench.check.page import judgement_page
from servo_bench.check.plan import Plan, load_plan, need_the_plans
from servo_bench.cli.keeping import recorded_at
from servo_bench.cli.output import check_outputs, write_bytes, write_json, write_text
from servo_bench.cli.run import STOPPED_BY_OPERATOR, play, tell_summary
from servo_bench.errors import BenchError, ConfigError
from servo_bench.excitation.experiment import Experiment
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import Recording
from servo_bench.rig import RigConfig
from servo_bench.run.virtual import run_virtually, save

NOT_PASSED = 10
"""The exit code of a rig that was judged, and did not pass."""


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("check")(check)


def check(
    plan: Annotated[str, typer.Argument(help="The acceptance plan (TOML).")],
    *,
    recording: Annotated[
        Path | None, typer.Option(help="Judge this recording; nothing is played.")
    ] = None,
    permit_real_rig: Annotated[
        bool,
        typer.Option("--permit-real-rig", help="Play on the rig on the file's bus; it moves."),
    ] = False,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Keep the recording (MCAP).")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Write one HTML page to this file.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write the findings to this file.")] = None,
    junit: Annotated[Path | None, typer.Option(help="Write JUnit XML to this file.")] = None,
) -> None:
    """Play a plan's experiment and judge the result: figures, fitted numbers, verdict.

    On a software rig made from the rig's file, unless --permit-real-rig. Exit code 0 where every
    limit holds, 10 where one does not; errors keep their own.
    """
    check_outputs(out, report, json, junit)
    wanted, experiment, rig = load_plan(plan)
    console = Console(stderr=True, emoji=False)
    if recording is not None and (out is not None or permit_real_rig):
        raise ConfigError(
            "--recording judges what is there, and plays nothing: leave --out and "
            "--permit-real-rig away."
        )
    try:
        if recording is not None:
            recorded = load(recording)
            need_the_plans(recorded, experiment, rig)
        else:
            recorded = _played(wanted, experiment, rig, console, out, permitted=permit_real_rig)
        judgement = judge(wanted, recorded)
    except BenchError as error:
        if junit is not None:
            write_bytes(junit, error_xml(wanted.name, error))
        raise
    if junit is not None:
        write_bytes(junit, judgement_xml(judgement))
    if json is not None:
        write_json(json, judgement.numbers())
    if report is not None:
        write_text(report, judgement_page(judgement, recorded))
    _show(judgement)
    if not judgement.passed:
        raise typer.Exit(NOT_PASSED)


def _played(
    plan: Plan,
    experiment: Experiment,
    rig: RigConfig,
    console: Console,
    out: Path | None,
    *,
    permitted: bool,
) -> Recording:
    if not permitted and plan.time == "virtual":
        recorded = run_virtually(experiment, rig)
        if out is not None:
            save(recorded, out)
        return recorded
    with recorded_at(out, "check.mcap") as target:
        summary = play(
            *(experiment, rig, target, console), simulated=not permitted, who="servo-bench check"
        )
        tell_summary(summary, console)
        if summary.stopped_early:
            raise typer.Exit(STOPPED_BY_OPERATOR)
        return load(target)


def _show(judgement: Judgement) -> None:
    table = Table(show_edge=False)
    for column in ("figure", "found", "allowed", ""):
        table.add_column(column, overflow="fold")
    for finding in judgement.findings:
        mark = "passed" if finding.passed else "[bold red]FAILED[/]"
        table.add_row(escape(finding.name), finding.text, escape(finding.allowed), mark)
    console = Console()
    console.print(table)
    for finding in judgement.findings:
        if finding.remark:
            console.print(f"note: {finding.name}: {finding.remark}", markup=False, soft_wrap=True)
    console.print(judgement.sentence, markup=False, soft_wrap=True)
