"""Findings as lines on the terminal."""

from collections.abc import Sequence

import typer
from rich.console import Console
from rich.text import Text

from servo_bench.run.finding import Finding, Level

FAILED = 1
"""The exit code where something must be changed before the rig runs."""
_STYLES = {Level.OK: "green", Level.NOTE: "cyan", Level.CHANGE: "yellow", Level.STOP: "bold red"}


def show(console: Console, findings: Sequence[Finding]) -> None:
    """One line each."""
    for finding in findings:
        line = Text(f"{finding.level.value:>6}  ", style=_STYLES[finding.level])
        line.append(f"{finding.subject}: ", style="bold")
        line.append(finding.text, style="default")
        console.print(line, soft_wrap=True, highlight=False)


def conclude(console: Console, findings: Sequence[Finding], good: str) -> None:
    """The last line; ends with `FAILED` where a finding says stop."""
    stops = sum(finding.level is Level.STOP for finding in findings)
    changes = sum(finding.level is Level.CHANGE for finding in findings)
    if stops:
        console.print(f"{stops} to mend before the rig runs, {changes} to change.")
        raise typer.Exit(FAILED)
    console.print(f"{good} {changes} to change." if changes else good)
