"""`servo-bench doctor`: this computer, the wire, the drive, the encoder, and what to change."""

import logging
from contextlib import ExitStack
from typing import Annotated

import typer
from rich.console import Console

from drivers.canopen.settings import CanopenSettings
from servo_bench.cli.findings import conclude, show
from servo_bench.cli.rig import DEFAULT_RIG
from servo_bench.cli.stopping import asked_to_stop
from servo_bench.errors import BenchError
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.axes import axis_settings
from servo_bench.run.doctor import canopen, counter, host, modbus, move
from servo_bench.run.finding import Finding, Level, stop
from servo_bench.run.lock import holding_rig


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("doctor")(doctor)


def doctor(
    rig: Annotated[str, typer.Option(help="Rig file.")] = DEFAULT_RIG,
    *,
    period_ms: Annotated[float, typer.Option(min=0.5, max=255.0, help="Period to judge by.")] = 8.0,
    port: Annotated[int | None, typer.Option(help="TCP port of the bus.")] = None,
    moving: Annotated[
        bool,
        typer.Option("--move", help="Turn the shaft slowly, after asking: counts and direction."),
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before the move.")] = False,
) -> None:
    """Examine computer, wire, drive, and encoder, and print what to change.

    Without --move nothing is enabled. Exit code 1 where something must be mended first.
    """
    logging.getLogger("can").setLevel(logging.CRITICAL)  # what it logs the findings say
    chosen = load_rig(rig)
    if port is not None:
        chosen = chosen.with_bus(port=port)
    console = Console(emoji=False)
    with ExitStack() as held:
        findings = [*host.examine(), *_wire(chosen, period_ms * 1e-3, held)]
        show(console, findings)
        if moving:
            told = _move(chosen, period_ms * 1e-3, findings, yes=yes)
            show(console, told)
            findings = findings + told
        else:
            show(console, advice := [move.advice()])
            findings = findings + advice
    conclude(console, findings, "the rig is ready.")


def _wire(rig: RigConfig, period_s: float, held: ExitStack) -> list[Finding]:
    """What the wire tells, and the rig held for a move; nothing where somebody else has it."""
    try:
        held.enter_context(holding_rig(rig.bus, "servo-bench doctor"))
        settings, beside = axis_settings(rig, period_s), rig.counter_settings(period_s)
        told = [] if beside is None else counter.examine(beside)
        if isinstance(settings, CanopenSettings):
            return [*told, *canopen.examine(settings)]
        return [*told, *modbus.examine(settings)]
    except BenchError as error:
        return [stop("wire", str(error))]


def _move(rig: RigConfig, period_s: float, findings: list[Finding], *, yes: bool) -> list[Finding]:
    if any(finding.level is Level.STOP for finding in findings):
        return [stop("move", "nothing moves before the rest is mended.")]
    if not yes and not typer.confirm(move.words(rig), err=True):
        return [move.advice()]
    try:
        with asked_to_stop() as asked:  # the drive's torque limit must be given back
            return move.examine(rig, period_s, stop_asked=asked, stopped_by=lambda: asked.by)
    except BenchError as error:
        return [stop("move", str(error))]
