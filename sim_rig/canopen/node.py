"""A CANopen slave: NMT, SDO, SYNC and PDOs, heartbeats, guarding, emergencies (CiA 301).

The engine has no thread and no clock: frames come in through `receive` with the time the bus
stamped on them, time passes through `tick`, and what it has to say goes out through `send`. The
device behind it is a `Device`; the object dictionary is where the two meet.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import Protocol

import canopen
from canopen.emcy import EMCY_STRUCT
from canopen.sdo.server import SdoServer

from sim_rig.canopen.guarding import Guarding
from sim_rig.canopen.objects import Abort, ObjectStore, refuse
from sim_rig.canopen.pdo import EVENT_DRIVEN, LAST_SYNCHRONOUS, Pdo
from sim_rig.canopen.producer import SyncProducer

NMT_COMMAND = 0x000
HEARTBEAT = 0x700
SDO_REQUEST = 0x600
SDO_ANSWER = 0x580

_GENERIC_ERROR = 0x01
COMMUNICATION_ERROR = 0x10
_MASTER_LOST = 0x8130
_PDO_TOO_SHORT = 0x8210
_REMEMBERED_ERRORS = 4

Send = Callable[[int, bytes], None]


class NmtState(IntEnum):
    """The states that a heartbeat tells."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """What a master may order."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


class Device(Protocol):
    """What a slave does beside communicating."""

    def sample(self, time_us: int) -> None:
        """Let the world reach `time_us` and put its inputs into the object dictionary."""
        ...

    def connection_lost(self) -> None:
        """The master is gone, or stopped the node: do what object 0x6007 says."""
        ...

    def reset(self) -> None:
        """Be as after power-on."""
        ...


class _Outlet(canopen.Network):
    """canopen's SDO server answers into a network; this one only hands its frames on."""

    def __init__(self, send: Send) -> None:
        super().__init__()
        self._send = send

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:  # noqa: ARG002
        self._send(can_id, bytes(data))


def _sdo_server(node_id: int, store: ObjectStore, send: Send) -> SdoServer:
    server = SdoServer(SDO_REQUEST + node_id, SDO_ANSWER + node_id, store)
    server.network = _Outlet(send)
    # Until its first transfer it holds None here, and cannot abort what comes out of turn.
    server._index = server._subindex = 0
    return server


class Slave:
    """One node. `send(identifier, data)` puts a frame on the bus; times are microseconds."""

    def __init__(self, node_id: int, store: ObjectStore, send: Send) -> None:
        self.node_id = node_id
        self.store = store
        self.nmt = NmtState.BOOT_UP
        self._send = send
        self._device: Device | None = None
        self._sdo = _sdo_server(node_id, store, send)
        self._receive_pdos = self._pdos(0x1400, 0x1600, transmits=False)
        self._transmit_pdos = self._pdos(0x1800, 0x1A00, transmits=True)
        self._pending: dict[int, tuple[Pdo, bytes]] = {}
        self._syncs = 0
        self._last_sent: dict[int, bytes] = {}
        self._heartbeat_due_us: int | None = None
        self._master_due_us: int | None = None
        self._guarding = Guarding(store)
        self._producer = SyncProducer(store)
        self._time_us = 0
        store.on_write((0x1003, 0), self._clear_errors)
        store.on_write((0x1016, 1), self._watch_anew)
        store.on_write((0x1017, 0), self._beat_anew)

    def _pdos(self, communication: int, mapping: int, *, transmits: bool) -> list[Pdo]:
        return [
            Pdo(
                self.store,
                index,
                mapping + index - communication,
                transmits=transmits,
                mapping_is_open=lambda: self.nmt is not NmtState.OPERATIONAL,
            )
            for index in range(communication, communication + 16)
            if index in self.store.object_dictionary
        ]

    def attach(self, device: Device) -> None:
        """Say what this node is."""
        self._device = device

    def boot(self) -> None:
        """Send the boot-up message and wait in pre-operational."""
        self.nmt = NmtState.BOOT_UP
        self._send(HEARTBEAT + self.node_id, bytes([NmtState.BOOT_UP]))
        self.nmt = NmtState.PRE_OPERATIONAL

    def power_cycle(self, time_us: int) -> None:
        """Lose power for an instant: everything is forgotten, and the boot-up message comes."""
        self._obey(NmtCommand.RESET_NODE, time_us)

    @property
    def produces_sync(self) -> bool:
        """Whether SYNC is this node's own."""
        return self._producer.produces

    def receive_remote(self, can_id: int, time_us: int) -> None:
        """A remote frame from the bus: the master guards this node."""
        if can_id == HEARTBEAT + self.node_id:
            answer = self._guarding.answer(self.nmt, time_us)
            if answer is not None:
                self._end_communication_error()
                self._send(can_id, answer)

    def receive(self, can_id: int, data: bytes, time_us: int) -> None:
        """One frame from the bus, stamped `time_us`."""
        self._time_us = time_us
        self._producer.see_time(time_us)
        if can_id == self._producer.cob_id:
            self._synchronise(time_us)
        elif can_id == NMT_COMMAND:
            if len(data) == 2 and data[1] in (0, self.node_id):
                self._obey(data[0], time_us)
        elif can_id == SDO_REQUEST + self.node_id:
            if len(data) == 8 and self.nmt is not NmtState.STOPPED:
                self._sample(time_us)
                self._sdo.on_request(can_id, data, time_us * 1e-6)
        elif can_id == HEARTBEAT + self._watched_node:
            self._hear_master(time_us)
        elif self.nmt is NmtState.OPERATIONAL:
            self._receive_pdo(can_id, data, time_us)

    def tick(self, now_us: int) -> None:
        """Do what is due by now: heartbeats, the master's silence, event timers."""
        self._time_us = now_us
        self.beat(now_us)
        silent = self._master_due_us is not None and now_us >= self._master_due_us
        if silent:
            self._master_due_us = None
        if self._guarding.expired(now_us) or silent:
            self._sample(now_us)
            self.emergency(_MASTER_LOST, COMMUNICATION_ERROR)
            if self._device is not None:
                self._device.connection_lost()
        if self._producer.is_due(now_us) and self.nmt is not NmtState.STOPPED:
            self._send(self._producer.cob_id, b"")
        if self.nmt is NmtState.OPERATIONAL:
            self._transmit_events(now_us)

    def beat(self, now_us: int) -> None:
        """Send the heartbeat if it is due: it waits for nothing that the bus may bring."""
        if self._heartbeat_due_us is not None and now_us >= self._heartbeat_due_us:
            self._send(HEARTBEAT + self.node_id, bytes([self.nmt]))
            self._heartbeat_due_us = self._next(self._heartbeat_due_us, self._beat_us, now_us)

    def due_us(self) -> int | None:
        """When `tick` has to be called next; None while nothing is planned."""
        timers = [self._heartbeat_due_us, self._master_due_us]
        timers += [self._guarding.due_us, self._producer.due_us]
        if self.nmt is NmtState.OPERATIONAL:
            timers += [pdo.event_due_us for pdo in self._transmit_pdos]
        return min((due for due in timers if due is not None), default=None)

    def emergency(self, code: int, register: int) -> None:
        """Send and remember an error; `register` holds the bits of 0x1001 it sets."""
        store = self.store
        store[0x1001, 0] |= _GENERIC_ERROR | register
        for place in range(_REMEMBERED_ERRORS, 1, -1):
            store[0x1003, place] = store[0x1003, place - 1]
        store[0x1003, 1] = code
        store[0x1003, 0] = min(store[0x1003, 0] + 1, _REMEMBERED_ERRORS)
        self._send_emergency(code)

    def emergency_over(self, register: int) -> None:
        """Take bits out of 0x1001; when none is left, say that all errors are gone."""
        before = self.store[0x1001, 0]
        left = before & ~(register | _GENERIC_ERROR)
        self.store[0x1001, 0] = left and left | _GENERIC_ERROR
        if before and not left:
            self._send_emergency(0)

    def _send_emergency(self, code: int) -> None:
        if self.nmt in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL):
            frame = EMCY_STRUCT.pack(code, self.store[0x1001, 0], bytes(5))
            self._send(self.store[0x1014, 0] & 0x7FF, frame)

    def _sample(self, time_us: int) -> None:
        self.store[0x1013, 0] = time_us & 0xFFFFFFFF
        if self._device is not None:
            self._device.sample(time_us)

    # NMT

    def _obey(self, command: int, time_us: int) -> None:
        self._sample(time_us)
        match command:
            case NmtCommand.START:
                self.nmt = NmtState.OPERATIONAL
                for pdo in self._transmit_pdos:
                    pdo.event_due_us = time_us
            case NmtCommand.STOP:
                self.nmt = NmtState.STOPPED
                if self._device is not None:
                    self._device.connection_lost()
            case NmtCommand.ENTER_PRE_OPERATIONAL:
                self.nmt = NmtState.PRE_OPERATIONAL
            case NmtCommand.RESET_NODE:
                self.store.restore()
                if self._device is not None:
                    self._device.reset()
                self._restart()
            case NmtCommand.RESET_COMMUNICATION:
                if self._device is not None:
                    self._device.connection_lost()
                self.store.restore(last=0x1FFF)
                self._restart()
        if self.nmt is not NmtState.OPERATIONAL:
            self._pending.clear()

    def _restart(self) -> None:
        for pdo in self._receive_pdos + self._transmit_pdos:
            pdo.forget()
        self._heartbeat_due_us = self._master_due_us = None
        self._guarding.forget()
        self._producer.forget()
        self._syncs = 0
        self._last_sent.clear()
        self._sdo = _sdo_server(self.node_id, self.store, self._send)
        self.boot()

    # SYNC and PDOs

    def _synchronise(self, time_us: int) -> None:
        """Sample, tell, and only then do what the master sent since the SYNC before."""
        if self.nmt is not NmtState.OPERATIONAL:
            return
        self._sample(time_us)
        self._syncs += 1
        for pdo in self._transmit_pdos:
            kind = pdo.transmission
            if kind <= LAST_SYNCHRONOUS and pdo.enabled and self._syncs % max(kind, 1) == 0:
                self._transmit(pdo, only_changes=kind == 0)
        pending, self._pending = self._pending, {}
        for pdo, data in pending.values():
            pdo.unpack(data)

    def _transmit(self, pdo: Pdo, *, only_changes: bool = False) -> None:
        data = pdo.pack()
        if only_changes and self._last_sent.get(pdo.cob_id) == data:
            return
        self._last_sent[pdo.cob_id] = data
        self._send(pdo.cob_id, data)

    def _transmit_events(self, now_us: int) -> None:
        for pdo in self._transmit_pdos:
            if pdo.transmission in EVENT_DRIVEN and pdo.enabled:
                if pdo.event_due_us is not None and now_us >= pdo.event_due_us:
                    self._sample(now_us)
                    self._transmit(pdo)
                period = pdo.event_timer_us
                pdo.event_due_us = self._next(pdo.event_due_us or now_us, period, now_us)
            else:
                pdo.event_due_us = None

    def _receive_pdo(self, can_id: int, data: bytes, time_us: int) -> None:
        for pdo in self._receive_pdos:
            if not pdo.enabled or pdo.cob_id != can_id:
                continue
            if len(data) < pdo.size:
                self.emergency(_PDO_TOO_SHORT, COMMUNICATION_ERROR)
            elif pdo.transmission <= LAST_SYNCHRONOUS:
                self._pending[can_id] = (pdo, data)
            else:
                self._sample(time_us)
                pdo.unpack(data)

    # Heartbeats

    @staticmethod
    def _next(due_us: int, period_us: int, now_us: int) -> int | None:
        """The next deadline on the same grid, after one was kept; None without a period."""
        if not period_us:
            return None
        return max(due_us + period_us, now_us) if now_us >= due_us else due_us

    @property
    def _beat_us(self) -> int:
        return self.store[0x1017, 0] * 1000

    def _beat_anew(self, period_ms: int) -> None:
        self._heartbeat_due_us = self._time_us if period_ms else None

    @property
    def _watched_node(self) -> int:
        return self.store[0x1016, 1] >> 16 & 0x7F

    def _watch_anew(self, value: int) -> None:
        if value >> 24 or value >> 16 > 127:
            raise refuse(Abort.INVALID_VALUE)
        # CiA 301: the watch begins with the first heartbeat heard, not with its configuration.
        self._master_due_us = None

    def _hear_master(self, time_us: int) -> None:
        timeout_us = (self.store[0x1016, 1] & 0xFFFF) * 1000
        if not timeout_us or not self._watched_node:
            return
        if self._master_due_us is None:
            self._end_communication_error()
        self._master_due_us = time_us + timeout_us

    def _end_communication_error(self) -> None:
        if self.store[0x1001, 0] & COMMUNICATION_ERROR:
            self.emergency_over(COMMUNICATION_ERROR)

    def _clear_errors(self, value: int) -> None:
        if value:
            raise refuse(Abort.INVALID_VALUE)
        for place in range(1, _REMEMBERED_ERRORS + 1):
            self.store[0x1003, place] = 0
