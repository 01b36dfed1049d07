"""`servo-bench drives`: the drive profiles that ship, and what each does its own way."""

from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from drivers.canopen.profile import DriveProfile, load_profile, profile_names
from servo_bench.errors import gathered


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("drives")(drives)


def drives(
    name: Annotated[
        str | None, typer.Argument(help="One profile, by name or as a TOML file, in full.")
    ] = None,
) -> None:
    """List the drive profiles for `[drive] profile`; a new drive needs a TOML and its EDS."""
    console = Console()
    if name is not None:
        with gathered():
            _describe(name, load_profile(name), console)
        return
    table = Table("profile", "drive", "modes", "second encoder", "stops by itself on")
    for each in profile_names():
        profile = load_profile(each)
        table.add_row(
            each,
            profile.title,
            ", ".join(profile.modes),
            "0x60E4" if profile.offers_load_position else "-",
            profile.stopping.watchdog,
        )
    console.print(table)


def _describe(name: str, profile: DriveProfile, console: Console) -> None:
    timing, stopping = profile.timing, profile.stopping
    shortest_s, longest_s = timing.period_s
    lines = [
        f"{name}: {profile.title}",
        f"modes {', '.join(profile.modes)}; period {shortest_s * 1e3:g} to {longest_s * 1e3:g} ms; "
        f"0x60C2 gets {timing.interpolation_time}; a command acts "
        f"{timing.command_delay_cycles} SYNC(s) late",
        f"stops by itself on: {stopping.watchdog}; 0x605A = {stopping.quick_stop_option}, "
        f"0x6007 = {stopping.connection_lost_option}",
        *(f"note: {note}" for note in profile.notes),
        *(f"source: {source}" for source in profile.sources),
    ]
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)
