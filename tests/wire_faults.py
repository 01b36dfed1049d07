"""One fault scenario on the real wire: processes, TCP, CLOCK_MONOTONIC. See `fault_campaign`."""

import struct
from dataclasses import replace
from typing import Any

import can

from drivers.canopen.cia402 import POWERED, decode_state
from drivers.canopen.master import CanopenAxis
from servo_bench.clock import Clock, monotonic_ns
from servo_bench.errors import BenchError, gathered
from servo_bench.rig import RigConfig
from servo_bench.run.busloop import Player
from servo_bench.run.table import UNPLAYED, SlotTable
from sim_rig.process import spawn
from tests.fault_campaign import Outcome, rig_config
from tests.fault_scenarios import GOES_ON, Scenario

PATIENCE_S = 6.0
_STATUSWORD, _POSITION = 0x6041, 0x6064


def run_on_wire(it: Scenario, schedule: Any) -> Outcome:
    """Play a scenario on a rig of its own and look at what is left, as a stranger would."""
    outcome = Outcome(it)
    fatal: list[tuple[str, str]] = []

    def tell(kind: str, text: str, **data: Any) -> None:
        outcome.told.append(kind)
        if data.get("fatal"):
            fatal.append((kind, text))

    config = rig_config().on_a_free_port().with_faults(it.fault)
    plant = "tests.coasting_plant:coasting"
    settings = replace(config.simulation_settings(), seed=it.seed, plant=plant)
    with spawn(settings) as rig, SlotTable.create(schedule.slots) as table:
        config = config.with_bus(**rig.bus)
        begun_ns = monotonic_ns()
        try:
            with gathered(), CanopenAxis(config.canopen_settings(0.008)) as axis:
                player = Player(axis, schedule, table, config.limits, Clock())
                player.play(monotonic_ns() + 8_000_000, tell)
            outcome.cause = GOES_ON
        except BenchError as error:
            notes = " ".join([str(error), *getattr(error, "__notes__", ())])
            outcome.cause, outcome.text = fatal[0] if fatal else (type(error).__name__, notes)
        outcome.played = int((table.rows["slot"] != UNPLAYED).sum())
        outcome.stop_s = (monotonic_ns() - begun_ns) * 1e-9
        outcome.moving = not _stands(config)
    return outcome


def _stands(config: RigConfig) -> bool:
    """Whether the drive comes to say, within the patience, that it is off and does not turn."""
    until_ns = monotonic_ns() + round(PATIENCE_S * 1e9)
    with can.Bus(**config.bus) as bus:
        before: int | None = None
        while monotonic_ns() < until_ns:
            status, position = _read(bus, _STATUSWORD), _read(bus, _POSITION)
            if status is None or position is None:
                continue
            if decode_state(status) not in POWERED and position == before:
                return True
            before = position
    return False


def _read(bus: can.BusABC, index: int) -> int | None:
    """One expedited upload by hand; None where it is not answered at once."""
    request = struct.pack("<BHB4x", 0x40, index, 0)
    bus.send(can.Message(arbitration_id=0x601, data=request, is_extended_id=False))
    until_ns = monotonic_ns() + 100_000_000
    while monotonic_ns() < until_ns:
        frame = bus.recv(0.1)
        if frame is not None and frame.arbitration_id == 0x581 and frame.data[1:3] == request[1:3]:
            return int.from_bytes(frame.data[4:], "little")
    return None
