"""Every case of the bus loop that the bench claims, one after the other, each beside its reference.

CANopen at 8, 4, 2 and 1 ms; an 8 ms command whose angles are sampled every 1 ms; SYNC by the drive;
Modbus TCP at 8, 4 and 2 ms; Modbus RTU over a pty, whose bytes take their time, at the shortest
whole millisecond that the arithmetic allows, and at the shortest that leaves the computer a tenth;
beside these what a byte takes over a pty without any of this. Where the drive produces SYNC, the
lateness is how far its SYNCs came off their period, which is the software rig's.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from drivers.modbus.budget import shortest_period
from servo_bench.benchmark.cycle import measure
from servo_bench.errors import BenchError
from servo_bench.rig import load_rig
from servo_bench.run.session import Status

CANOPEN, TCP, RTU = "rigs/paper.toml", "rigs/modbus-tcp.toml", "rigs/modbus-rtu.toml"
ROOM = 1.1
_LONG_S = 0.05
"""A period that every line holds: only its plan is wanted."""


@dataclass(frozen=True, slots=True)
class Case:
    """One run: which rig file, at which period, and what its `[drive]` and `[bus]` have besides."""

    name: str
    rig: str
    period_s: float
    drive: Mapping[str, Any] = field(default_factory=dict)
    bus: Mapping[str, int | float | str] = field(default_factory=dict)
    arithmetic: str = ""


def cases() -> Iterator[Case]:
    """All of them, in the order in which they are measured."""
    for ms in (8, 4, 2, 1):
        yield Case(f"CANopen {ms} ms", CANOPEN, ms * 1e-3)
    yield Case("CANopen 8 ms, sampled every 1 ms", CANOPEN, 0.008, {"samples_per_command": 8})
    yield Case("CANopen 8 ms, SYNC by the drive", CANOPEN, 0.008, {"sync": "drive"})
    for ms in (8, 4, 2):
        yield Case(f"Modbus TCP {ms} ms", TCP, ms * 1e-3)
    for baud_rate in (115_200, 460_800, 921_600):
        shortest, with_room = (_shortest_rtu(baud_rate, room) for room in (1.0, ROOM))
        yield shortest
        if with_room.period_s > shortest.period_s:
            yield with_room


def _shortest_rtu(baud_rate: int, room: float) -> Case:
    settings = load_rig(RTU).with_bus(baud_rate=baud_rate).modbus_settings(_LONG_S)
    budget = shortest_period(settings.drive.profile, settings.line, settings.plan)
    ms = math.ceil(room * budget.total_s * 1e3 - 1e-6)
    return Case(
        f"Modbus RTU {baud_rate} Bd {ms} ms",
        RTU,
        ms * 1e-3,
        bus={"baud_rate": baud_rate},
        arithmetic=str(budget),
    )


def measure_all(
    *,
    seconds: float,
    priority: int,
    cpu: int | None,
    begin: Callable[[str], None] = lambda _: None,
    progress: Callable[[Status], None] = lambda _: None,
) -> dict[str, Any]:
    """The figures of every case by its name, ready for JSON; why not, where it ended."""
    figures: dict[str, Any] = {}
    for case in cases():
        begin(case.name)
        try:
            found = measure(
                period_s=case.period_s,
                seconds=seconds,
                priority=priority,
                cpu=cpu,
                rig_name=case.rig,
                drive=case.drive,
                bus=case.bus,
                progress=progress,
            )
        except BenchError as error:  # a machine too slow for one case may well play the others
            found = {"not_played": str(error)}
        how = {"arithmetic": case.arithmetic} if case.arithmetic else {}
        figures[case.name] = {"rig": case.rig, **how, **found}
    return {"cases": figures}
