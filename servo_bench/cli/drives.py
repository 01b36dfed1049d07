"""`servo-bench drives`: the drive profiles that ship, and what each does its own way."""

from typing import Annotated

import typer
from rich.console import Console
from rich.table import Column, Table

from drivers.canopen.profile import DriveProfile, load_profile, profile_names
from drivers.counter import profile as counters
from drivers.counter.profile import CounterProfile
from drivers.counter.settings import CounterLine, sum_of
from drivers.modbus import library as modbus
from drivers.modbus.budget import shortest_period
from drivers.modbus.lines import Line, RtuLine, TcpLine
from drivers.modbus.profile import LOAD
from drivers.modbus.profile import DriveProfile as RegisterMap
from servo_bench.errors import gathered

Lines = list[str]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("drives")(drives)


def drives(
    name: Annotated[
        str | None, typer.Argument(help="One profile, by name or as a TOML file, in full.")
    ] = None,
    modbus_only: Annotated[
        bool, typer.Option("--modbus", help="NAME is a register map, for a drive on Modbus.")
    ] = False,
    counter: Annotated[
        bool, typer.Option("--counter", help="NAME is the framing of a counter on a serial line.")
    ] = False,
) -> None:
    """List the drives and serial counters that a rig file can name; a new one needs a TOML file and
    no code.

    On CANopen a drive needs its EDS as well.
    """
    console = Console()
    if name is None:
        console.print(_canopen_table())
        console.print(_modbus_table())
        console.print(_counter_table())
        return
    with gathered():
        if counter or (name in counters.profile_names() and not modbus_only):
            lines = _describe_counter(name, counters.load_profile(name))
        elif modbus_only or (name in modbus.profile_names() and name not in profile_names()):
            lines = _describe_map(name, modbus.load_profile(name))
        else:
            lines = _describe(name, load_profile(name))
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def _canopen_table() -> Table:
    table = Table("profile", "drive", "modes", "second encoder", "stops by itself on")
    table.title = "CANopen"
    for each in profile_names():
        profile = load_profile(each)
        table.add_row(
            each,
            profile.title,
            ", ".join(profile.modes),
            "0x60E4" if profile.offers_load_position else "-",
            profile.stopping.watchdog,
        )
    return table


def _modbus_table() -> Table:
    table = Table("profile", "drive", "lines", "second encoder", "stops by itself")
    table.title = "Modbus (--modbus NAME tells more)"
    for each in modbus.profile_names():
        profile = modbus.load_profile(each)
        table.add_row(
            each,
            profile.title,
            ", ".join(profile.transports),
            f"register {profile.items[LOAD].address}" if LOAD in profile.items else "-",
            _own_stop(profile),
        )
    return table


def _counter_table() -> Table:
    name = Column("profile", no_wrap=True)
    table = Table(name, "counter", "request + answer", "check", "numbered", "index")
    table.title = "Serial counters: [encoder] profile (--counter NAME tells more)"
    for each in counters.profile_names():
        profile = counters.load_profile(each)
        fields = profile.answers.fields
        table.add_row(
            each,
            profile.title,
            f"{profile.asks.size} + {profile.answers.size} bytes",
            ", ".join(part.check for part in profile.answer if part.check) or "-",
            "yes" if profile.is_numbered else "-",
            "yes" if "index" in fields else "-",
        )
    return table


def _own_stop(profile: RegisterMap) -> str:
    if not profile.is_commanded:
        return "is read, not driven"
    return f"after {profile.watchdog.range_s[0]:g} s or more" if profile.watchdog else "does not"


def _describe(name: str, profile: DriveProfile) -> Lines:
    timing, stopping = profile.timing, profile.stopping
    shortest_s, longest_s = timing.period_s
    return [
        f"{name}: {profile.title}",
        f"modes {', '.join(profile.modes)}; period {shortest_s * 1e3:g} to {longest_s * 1e3:g} ms; "
        f"0x60C2 gets {timing.interpolation_time}; a command acts "
        f"{timing.command_delay_cycles} SYNC(s) late",
        f"stops by itself on: {stopping.watchdog}; 0x605A = {stopping.quick_stop_option}, "
        f"0x6007 = {stopping.connection_lost_option}",
        *(f"note: {note}" for note in profile.notes),
        *(f"source: {source}" for source in profile.sources),
    ]


def _describe_map(name: str, profile: RegisterMap) -> Lines:
    lines: list[tuple[str, Line]] = []
    if "modbus-tcp" in profile.transports:
        lines.append(("TCP", TcpLine("any")))
    if "modbus-rtu" in profile.transports:
        lines.append(("RTU", RtuLine("any", max(profile.timing.baud_rates))))
    return [
        f"{name}: {profile.title}",
        *(f"shortest period, {kind}: {shortest_period(profile, line)}" for kind, line in lines),
        f"stops by itself: {_own_stop(profile)}",
        *(f"note: {note}" for note in profile.notes),
        *(f"source: {source}" for source in profile.sources),
    ]


def _describe_counter(name: str, profile: CounterProfile) -> Lines:
    lines = [
        CounterLine(
            "any", rate, profile.line.data_bits, profile.line.parity, profile.line.stop_bits
        )
        for rate in profile.line.baud_rates
    ]
    return [
        f"{name}: {profile.title}",
        *(f"shortest period: {sum_of(profile, line)}" for line in lines),
        f"counts to {profile.range}, then runs over",
        *(f"note: {note}" for note in profile.notes),
        *(f"source: {source}" for source in profile.sources),
    ]
