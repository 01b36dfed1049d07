"""`drivers.stopline.StopLine` for CANopen: a bus connection of its own.

It hears emergencies, restarts, and heartbeats without the axis. A stop goes out as RPDO and SYNC
(one frame's time), then again by SDO, which the drive confirms; where nothing confirms, as NMT
stop, on which a drive does what 0x6007 says.
"""

from contextlib import suppress

import can

from drivers.axis import WireEvent
from drivers.canopen import cia402, pdo
from drivers.canopen.eds import load_eds
from drivers.canopen.guarding import LIFE_TIME_FACTOR
from drivers.canopen.line import Line, open_bus
from drivers.canopen.node import (
    EMERGENCY,
    HEARTBEAT,
    NMT_PRE_OPERATIONAL,
    NMT_STOP,
    SDO_RESPONSE,
    SYNC,
    Node,
)
from drivers.canopen.settings import CanopenSettings
from drivers.canopen.stopping import stop_by_sdo
from drivers.canopen.watch import Watch
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.errors import DriverError

SHARED_BUSES = frozenset({"socketcan", "socketcand", "udp_multicast"})
"""Interfaces of python-can on which every process may have a connection of its own."""
_FLOOD = 1000
_ASK_S = 0.1
_ATTEMPTS = 2


class CanopenStopLine:
    """See `drivers.stopline.StopLine`. SettingsError for an EDS that cannot be."""

    def __init__(self, settings: CanopenSettings, clock: Clock = SYSTEM_CLOCK) -> None:
        self._settings = settings
        self._clock = clock
        drive = settings.drive
        self._dictionary = load_eds(drive.node.eds, drive.node.node_id, (0x6040, 0x6041, 0x6064))
        self._watch = Watch(drive.heartbeat_timeout_s, csv=drive.mode == "csv")
        self._line: Line | None = None
        self._asked: Node | None = None

    def open(self) -> str:
        """Take a connection where the bus has several owners; see `StopLine.open`."""
        interface = self._settings.bus.get("interface")
        if interface not in SHARED_BUSES:
            return (
                f"{interface} has one owner: on a trip the bus loop is killed, the drive stops by "
                f"itself within {self._settings.drive.heartbeat_timeout_s:g} s, and the line is "
                "taken to tell it so."
            )
        self._line = self._connect()
        return "on a trip the stop goes out over a bus connection of its own."

    def _connect(self) -> Line:
        line = Line(open_bus(self._settings.bus), self._clock)
        nodes = [("drive", self._settings.drive.node.node_id)]
        if self._settings.encoder:
            nodes.append(("encoder", self._settings.encoder.node.node_id))
        filters: list[can.typechecking.CanFilter] = []
        for kind, node_id in nodes:
            self._listen(line, f"{kind} {node_id}", node_id)
            for base in (EMERGENCY, HEARTBEAT, SDO_RESPONSE):
                filters.append({"can_id": base + node_id, "can_mask": 0x7FF, "extended": False})
        if self._settings.bus.get("interface") == "socketcan":
            line.bus.set_filters(filters)  # in the kernel; elsewhere recv(0) would end at the first
        return line

    def _listen(self, line: Line, name: str, node_id: int) -> None:
        watch = self._watch

        def on_emergency(_cob_id: int, data: bytearray, _timestamp: float) -> None:
            watch.on_emergency(name, data, self._clock.now_ns())

        def on_heartbeat(_cob_id: int, data: bytearray, _timestamp: float) -> None:
            watch.on_heartbeat(name, data, self._clock.now_ns())

        line.network.subscribe(EMERGENCY + node_id, on_emergency)
        line.network.subscribe(HEARTBEAT + node_id, on_heartbeat)

    def poll(self) -> list[WireEvent]:
        """Take what has come; see `StopLine.poll`. A node that restarts is told each time."""
        if self._line is None:
            return []
        for _ in range(_FLOOD):
            frame = self._line.read(0.0)
            if frame is None:
                break
            if not (frame.is_error_frame or frame.is_remote_frame):
                self._line.network.notify(frame.arbitration_id, frame.data, frame.timestamp)
        events = self._watch.drain()
        if events:
            self._watch.forget()
        return events

    def temperature_c(self) -> float | None:
        """By SDO, where the profile names an object; see `StopLine.temperature_c`."""
        temperature = self._settings.drive.profile.temperature
        if temperature is None or self._line is None:
            return None
        try:
            self._asked = self._asked or self._node(self._line, _ASK_S)
            digits = self._asked.read(*temperature.object)
        except DriverError:
            return None  # whether the drive still answers is judged elsewhere
        return digits * temperature.c_per_digit

    def _node(self, line: Line, timeout_s: float) -> Node:
        return Node("drive", self._settings.drive.node.node_id, self._dictionary, line, timeout_s)

    def stop(self) -> str | None:
        """See `StopLine.stop`; a connection that fails is opened once more.

        NMT stop is the last word of all: a node that is stopped so hears neither PDO nor SDO.
        """
        reasons: list[str] = []
        for _ in range(_ATTEMPTS):
            try:
                if self._line is None:
                    self._line = self._connect()
                if self._stop(self._line):
                    return None
                reasons.append("it still says that it is powered")
            except DriverError as error:
                reasons.append(str(error).rstrip("."))
                if len(reasons) < _ATTEMPTS:
                    self.close()
        self._last_word()
        self.close()
        reason = "; ".join(dict.fromkeys(reasons))
        drive = self._settings.drive
        own_stop = (
            "it does not watch its master (drive.without_watchdog)"
            if drive.without_watchdog
            else f"it stops by itself {drive.heartbeat_timeout_s:g} s after its master's last word"
        )
        return (
            f"drive {drive.node.node_id} did not confirm its stop ({reason}). If it is still "
            f"powered, {own_stop}. Use the emergency stop if the shaft turns."
        )

    def _stop(self, line: Line) -> bool:
        drive = self._settings.drive
        node = self._node(line, drive.sdo_timeout_s)
        command = drive.profile.command
        layout = pdo.layout(node, pdo.RPDO, command.pdo, command.objects)
        line.send(layout.cob_id, layout.codec.pack(cia402.QUICK_STOP, 0))
        by_drive = self._settings.sync_by_drive
        if not by_drive:
            line.send(SYNC, b"")
        if not stop_by_sdo(node, drive.stop_timeout_s):
            return False
        ended = [(0x1016, 1, 0), (pdo.RPDO + command.pdo - 1, 5, 0)]
        ended += [(*LIFE_TIME_FACTOR, 0)] if node.has(*LIFE_TIME_FACTOR) else []
        ended += [(0x1005, 0, SYNC)] if by_drive else []
        for index, sub, value in ended:
            if node.writable(index, sub):
                with suppress(DriverError):  # it is off: a watchdog that barks now harms nobody
                    node.write(index, sub, value)
        for node_id in self._node_ids:
            line.send(0x000, bytes((NMT_PRE_OPERATIONAL, node_id)))
        return True

    @property
    def _node_ids(self) -> list[int]:
        encoder = self._settings.encoder
        drive_id = self._settings.drive.node.node_id
        return [drive_id, encoder.node.node_id] if encoder else [drive_id]

    def _last_word(self) -> None:
        with suppress(DriverError):
            line = self._line = self._line or self._connect()
            line.send(0x000, bytes((NMT_STOP, self._settings.drive.node.node_id)))

    def close(self) -> None:
        """See `StopLine.close`."""
        line, self._line, self._asked = self._line, None, None
        if line is not None:
            line.close()
