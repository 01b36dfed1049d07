"""The drive behind the registers: reads, writes, and its communication timeout, without a wire.

The drive is the one of `sim_rig.canopen.drive402` on a bus of its own that nobody hears; its
objects are the registers. Time is microseconds of this host's monotonic clock: a request is as
old as its last byte. Without requests the machine follows `tick`.
"""

import logging
from collections.abc import Sequence

import canopen
from pymodbus.constants import ExcCodes

from sim_rig.canopen import drive402
from sim_rig.canopen.cia402 import State
from sim_rig.canopen.machine import Machine
from sim_rig.canopen.node import Slave
from sim_rig.canopen.objects import ObjectStore
from sim_rig.modbus.faults import Answers
from sim_rig.modbus.orders import parse
from sim_rig.modbus.table import BY_REGISTER, PRODUCT, VENDOR, Entry, Own
from sim_rig.plant import Plant
from sim_rig.settings import RigSettings

logging.getLogger("pymodbus.logging").addHandler(logging.NullHandler())

_QUIET_US = 50_000
_LAG_US = 1_000
_MOVING_STEP_US = 4_000
_RESTING_STEP_US = 50_000


class ModbusDrive:
    """One drive with its registers. What reads and writes is pymodbus's datastore interface."""

    def __init__(self, settings: RigSettings, plant: Plant) -> None:
        self.unit = settings.drive_node_id
        self._machine = Machine(plant)
        self._store = ObjectStore(drive402.dictionary(self.unit))
        self._drive = drive402.Drive(
            Slave(self.unit, self._store, lambda _can_id, _data: None), self._machine, settings
        )
        mode = drive402.CYCLIC_SYNCHRONOUS_VELOCITY
        self._store.set_data(0x6060, 0, bytes([mode]))
        self._load_counts = settings.load_counts_per_revolution
        self._temperature = round(10.0 * settings.drive_temperature_c)
        self._timeout_us = 0
        self._last_request_us: int | None = None
        orders = [parse(line) for line in settings.faults]
        self.outgoing = Answers(
            orders, rtu=settings.protocol == "modbus-rtu", enabled=self.is_enabled
        )

    def is_enabled(self) -> bool:
        """Whether the power stage is on."""
        return self._drive.state is State.OPERATION_ENABLED

    def load_counts(self, time_us: int) -> int:
        """The load encoder's count at a time, for a device that is not on this line."""
        self._machine.advance_to(time_us)
        return self._drive.load_sensor.counts(self._machine.outputs.load_angle_rad)

    def request_arrived(self, time_us: int) -> None:
        """A request's last byte came at `time_us`: the machine is brought there."""
        self.tick(time_us, lag_us=0)
        self._last_request_us = time_us
        self._sample(time_us)

    def tick(self, now_us: int, lag_us: int = _LAG_US) -> None:
        """Do what is due: stop by itself when no request has come for the timeout."""
        due_us = self._due_us
        if due_us is not None and now_us > due_us:
            self._sample(due_us)
            self._last_request_us = None
            self._drive.connection_lost()
        quiet_us = now_us - (self._last_request_us or 0)
        if quiet_us > _QUIET_US:
            self._sample(now_us - lag_us)

    def wait_us(self, now_us: int) -> int:
        """How long `tick` can wait, if no request comes."""
        waits = [_MOVING_STEP_US if self._drive.moves else _RESTING_STEP_US]
        if self._due_us is not None:
            waits.append(self._due_us - now_us + 1)
        return max(0, min(waits))

    @property
    def _due_us(self) -> int | None:
        if not self._timeout_us or self._last_request_us is None:
            return None
        return self._last_request_us + self._timeout_us

    def _sample(self, time_us: int) -> None:
        self._store[0x1013, 0] = time_us & 0xFFFFFFFF
        self._drive.sample(time_us)

    # pymodbus's datastore interface; its server and its PDUs call these

    async def async_getValues(  # noqa: N802
        self, device_id: int, func_code: int, address: int, count: int = 1
    ) -> list[int] | ExcCodes:
        """Registers, as many as asked, or the exception to answer with."""
        if device_id != self.unit or func_code not in (3, 4, 6, 16, 23):
            return ExcCodes.ILLEGAL_FUNCTION
        return self.read(address, count)

    async def async_setValues(  # noqa: N802
        self, device_id: int, func_code: int, address: int, values: Sequence[int]
    ) -> ExcCodes | None:
        """Write registers; the exception to answer with, or None."""
        if device_id != self.unit or func_code not in (6, 16, 23):
            return ExcCodes.ILLEGAL_FUNCTION
        return self.write(address, values)

    def read(self, address: int, count: int) -> list[int] | ExcCodes:
        """Registers from `address` on."""
        words: list[int] = []
        for register in range(address, address + count):
            entry = BY_REGISTER.get(register)
            if entry is None:
                return ExcCodes.ILLEGAL_ADDRESS
            shift = 16 * (entry.end - 1 - register)
            words.append(self._value(entry) >> shift & 0xFFFF)
        return words

    def write(self, address: int, words: Sequence[int]) -> ExcCodes | None:
        """Write registers from `address` on, quantity by quantity, until one is refused."""
        place = 0
        while place < len(words):
            entry = BY_REGISTER.get(address + place)
            if entry is None or entry.address != address + place or not entry.writable:
                return ExcCodes.ILLEGAL_ADDRESS
            part = words[place : place + entry.words]
            if len(part) < entry.words:
                return ExcCodes.ILLEGAL_VALUE  # half a quantity
            refused = self._set(entry, b"".join(word.to_bytes(2, "big") for word in part))
            if refused is not None:
                return refused
            place += entry.words
        return None

    def _value(self, entry: Entry) -> int:
        if not isinstance(entry.behind, Own):
            return self._store[entry.behind]
        return {
            Own.VENDOR: VENDOR,
            Own.PRODUCT: PRODUCT,
            Own.TIMEOUT: self._timeout_us // 1000,
            Own.LOAD_COUNTS: self._load_counts,
            Own.TEMPERATURE: self._temperature & 0xFFFF,
            Own.SPARE: 0,
        }[entry.behind]

    def _set(self, entry: Entry, data: bytes) -> ExcCodes | None:
        if isinstance(entry.behind, Own):
            self._timeout_us = int.from_bytes(data, "big") * 1000
            return None
        try:
            self._store.set_data(*entry.behind, data[::-1])
        except canopen.SdoAbortedError:
            return ExcCodes.ILLEGAL_VALUE
        return None
