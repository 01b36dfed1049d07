"""One fault scenario on the real wire: processes, TCP, ptys, real time. See `fault_campaign`."""

import os
import select
import socket
import struct
import termios
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import can

from drivers.canopen.cia402 import POWERED, decode_state
from servo_bench.clock import Clock, monotonic_ns
from servo_bench.errors import BenchError, gathered
from servo_bench.recording.recording import Event
from servo_bench.rig import RigConfig
from servo_bench.run.axes import open_axis
from servo_bench.run.busloop import Player
from servo_bench.run.table import UNPLAYED, SlotTable
from sim_rig.process import spawn
from tests.fault_campaign import HangError, config_of, plan_of, recorded, schedule
from tests.fault_outcome import Outcome
from tests.fault_scenarios import Scenario
from tests.modbus_peer import rtu_frame, tcp_frame

PERIOD_S = 0.008
PATIENCE_S = 6.0
ANSWER_S = 1.0
"""A slow slave is slow for whoever looks at it, too."""
MODBUS_LOOK_S = 0.5
"""Whoever asks a drive more often than its communication timeout keeps it from its own stop."""
_STATUSWORD, _POSITION = 0x6041, 0x6064
_READ_STATE = bytes([3, 0x02, 0x00, 0, 5])
"""Modbus: the registers from the statusword to the motor's position."""


class StallClock(Clock):
    """In its `at`-th wait the bench sleeps too long."""

    def __init__(self, at: int, for_s: float) -> None:
        self._waits_left, self._for_ns = at, round(for_s * 1e9)

    def sleep_until(self, deadline_ns: int) -> int:
        late_ns = self._for_ns if self._waits_left == 0 else 0
        self._waits_left -= 1
        return super().sleep_until(deadline_ns + late_ns)


def run_on_wire(it: Scenario, folder: Path) -> Outcome:
    """Play a scenario on a rig of its own and look at what is left, as a stranger would."""
    outcome = Outcome(it)
    events: list[Event] = []
    played = schedule(plan_of(it))

    def tell(kind: str, text: str, **data: Any) -> None:
        events.append(Event(monotonic_ns(), kind, text))
        outcome.tell(kind, text, **data)

    config = config_of(it).on_a_free_port()
    with spawn(config.simulation_settings()) as rig, SlotTable.create(played.slots) as table:
        config = config.with_bus(**rig.bus)
        try:
            with gathered(), open_axis(config, PERIOD_S) as axis:
                player = Player(axis, played, table, config.limits, StallClock(*it.stall))
                player.play(monotonic_ns() + 8_000_000, tell)
            outcome.ended(None)
        except BenchError as error:
            outcome.ended(error)
        except HangError:
            outcome.hung = True
        ended_ns = monotonic_ns()
        outcome.played = int((table.rows["slot"] != UNPLAYED).sum())
        outcome.moving = not _stands(config)
        outcome.stop_s = (monotonic_ns() - ended_ns) * 1e-9
        outcome.readable = recorded(folder, it, table, events)
    return outcome


def _stands(config: RigConfig) -> bool:
    """Whether the drive comes to say, within the patience, that it is off and does not turn."""
    until_ns = monotonic_ns() + round(PATIENCE_S * 1e9)
    if config.drive.protocol != "canopen":
        return _comes_to_rest(lambda: _modbus_state(config, MODBUS_LOOK_S), until_ns)
    with can.Bus(**config.bus) as bus:
        return _comes_to_rest(lambda: (_read(bus, _STATUSWORD), _read(bus, _POSITION)), until_ns)


def _comes_to_rest(state: Any, until_ns: int) -> bool:
    before: int | None = None
    while monotonic_ns() < until_ns:
        status, position = state()
        if status is None or position is None:
            continue
        if decode_state(status) not in POWERED and position == before:
            return True
        before = position
    return False


def _read(bus: can.BusABC, index: int) -> int | None:
    """One expedited upload by hand; None where it is not answered in time."""
    request = struct.pack("<BHB4x", 0x40, index, 0)
    bus.send(can.Message(arbitration_id=0x601, data=request, is_extended_id=False))
    until_ns = monotonic_ns() + round(ANSWER_S * 1e9)
    while monotonic_ns() < until_ns:
        frame = bus.recv(0.1)
        if frame is not None and frame.arbitration_id == 0x581 and frame.data[1:3] == request[1:3]:
            return int.from_bytes(frame.data[4:], "little")
    return None


def _modbus_state(config: RigConfig, after_s: float) -> tuple[int | None, int | None]:
    """Statusword and position by hand, after a while; None where they are not answered at once."""
    time.sleep(after_s)
    if "device" in config.bus:
        device = os.open(str(config.bus["device"]), os.O_RDWR | os.O_NOCTTY)
        try:
            termios.tcflush(device, termios.TCIFLUSH)
            os.write(device, rtu_frame(_READ_STATE))
            answer, head = _answer(lambda: os.read(device, 256), device, 15), 3
        finally:
            os.close(device)
    else:
        address = str(config.bus["host"]), int(config.bus["port"])
        with closing(socket.create_connection(address, 5.0)) as connection:
            connection.sendall(tcp_frame(_READ_STATE, 1))
            answer, head = _answer(lambda: connection.recv(100), connection.fileno(), 19), 9
    words = [word for (word,) in struct.iter_unpack(">H", answer[head : head + 10])]
    return (words[0], words[3] << 16 | words[4]) if len(words) == 5 else (None, None)


def _answer(read: Any, descriptor: int, size: int) -> bytes:
    got = b""
    while len(got) < size and select.select([descriptor], [], [], 0.5)[0]:
        got += read()
    return got
