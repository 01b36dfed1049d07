"""Process data objects of a slave: what a frame carries, as the master configured it.

Communication parameters 0x1400/0x1800, mappings 0x1600/0x1A00 (CiA 301). The master disables a
PDO (COB-ID bit 31), clears the mapping's count, writes its entries, the count, and enables it
again; out of that order, or in NMT operational, it is refused.
"""

from collections.abc import Callable
from contextlib import suppress

import canopen

from sim_rig.canopen.objects import Abort, Address, ObjectStore, refuse

DISABLED = 0x80000000
EXTENDED = 0x20000000
LAST_SYNCHRONOUS = 240
EVENT_DRIVEN = (254, 255)

_COB_ID = 1
_TRANSMISSION = 2
_EVENT_TIMER = 5
_LONGEST_BITS = 64
_MOST_ENTRIES = 8

_RESERVED = [
    range(0x000, 0x081),
    range(0x101, 0x181),
    range(0x581, 0x600),
    range(0x601, 0x680),
    range(0x6E0, 0x800),
]
"""Identifiers that CiA 301 keeps from PDOs, SYNC's default included."""


class Pdo:
    """One PDO in either direction: `communication` and `mapping` are its two objects' indices."""

    def __init__(
        self,
        store: ObjectStore,
        communication: int,
        mapping: int,
        *,
        transmits: bool,
        mapping_is_open: Callable[[], bool],
    ) -> None:
        self._store = store
        self._communication = communication
        self._mapping = mapping
        self._transmits = transmits
        self._mapping_is_open = mapping_is_open
        self._entries: list[tuple[Address, int]] | None = None
        self.event_due_us: int | None = None
        store.on_write((communication, _COB_ID), self._check_cob_id)
        store.on_write((communication, _TRANSMISSION), self._check_transmission)
        store.on_write((mapping, 0), self._check_count)
        for entry in range(1, _MOST_ENTRIES + 1):
            store.on_write((mapping, entry), self._check_entry)

    @property
    def cob_id(self) -> int:
        """The identifier on the wire."""
        return self._store[self._communication, _COB_ID] & 0x7FF

    @property
    def enabled(self) -> bool:
        """Whether it exists, and carries anything."""
        return not self._store[self._communication, _COB_ID] & DISABLED and bool(self.entries)

    @property
    def transmission(self) -> int:
        """0 at the SYNC after a change, n at every n-th SYNC, 254 and 255 by events."""
        return self._store[self._communication, _TRANSMISSION]

    @property
    def event_timer_us(self) -> int:
        """The period of an event-driven TPDO; 0 is none."""
        return self._store[self._communication, _EVENT_TIMER] * 1000

    @property
    def entries(self) -> list[tuple[Address, int]]:
        """What it carries, in order: address and size in bytes."""
        if self._entries is None:
            count = self._store[self._mapping, 0]
            mapped = [self._store[self._mapping, entry] for entry in range(1, count + 1)]
            self._entries = [((m >> 16, m >> 8 & 0xFF), (m & 0xFF) // 8) for m in mapped]
        return self._entries

    def forget(self) -> None:
        """Read the mapping again: the store was restored under it."""
        self._entries = None
        self.event_due_us = None

    def pack(self) -> bytes:
        """The frame's data, from the store's present values."""
        store = self._store
        return b"".join(
            (store[address] & ((1 << 8 * size) - 1)).to_bytes(size, "little")
            for address, size in self.entries
        )

    def unpack(self, data: bytes) -> None:
        """Write the frame's data to the objects. A value the device refuses is left out."""
        at = 0
        for (index, subindex), size in self.entries:
            # CiA 301 has no answer to a PDO: a refused object keeps its value, as on real drives.
            with suppress(canopen.SdoAbortedError):
                self._store.set_data(index, subindex, data[at : at + size])
            at += size

    @property
    def size(self) -> int:
        """Bytes it carries."""
        return sum(size for _, size in self.entries)

    def _check_cob_id(self, value: int) -> None:
        identifier = value & 0x7FF
        if value & EXTENDED or value & 0x1FFFF800 or any(identifier in r for r in _RESERVED):
            raise refuse(Abort.INVALID_VALUE)
        now = self._store[self._communication, _COB_ID]
        if not (now | value) & DISABLED and (now ^ value) & 0x7FF:
            raise refuse(Abort.INVALID_VALUE)
        self.event_due_us = None

    def _check_transmission(self, value: int) -> None:
        if value > LAST_SYNCHRONOUS and value not in EVENT_DRIVEN:
            raise refuse(Abort.INVALID_VALUE)

    def _check_open(self) -> None:
        if not self._mapping_is_open():
            raise refuse(Abort.DEVICE_STATE)
        if not self._store[self._communication, _COB_ID] & DISABLED:
            raise refuse(Abort.UNSUPPORTED_ACCESS)

    def _check_count(self, count: int) -> None:
        self._check_open()
        if count > _MOST_ENTRIES:
            raise refuse(Abort.INVALID_VALUE)
        bits = 0
        for entry in range(1, count + 1):
            mapped = self._store[self._mapping, entry]
            self._check_mappable(mapped)
            bits += mapped & 0xFF
        if bits > _LONGEST_BITS:
            raise refuse(Abort.PDO_TOO_LONG)
        self._entries = None

    def _check_entry(self, mapped: int) -> None:
        self._check_open()
        if self._store[self._mapping, 0] != 0:
            raise refuse(Abort.UNSUPPORTED_ACCESS)
        if mapped:
            self._check_mappable(mapped)

    def _check_mappable(self, mapped: int) -> None:
        variable = self._store.variable(mapped >> 16, mapped >> 8 & 0xFF)
        allowed = variable.readable if self._transmits else variable.writable
        if not (variable.pdo_mappable and allowed) or mapped & 0xFF != len(variable):
            raise refuse(Abort.NOT_MAPPABLE)
