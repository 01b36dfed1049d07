"""Node guarding as a slave has it (CiA 301): answers the master's remote frames, misses them.

The master asks on 0x700 + node by a remote frame; the answer is the NMT state, its highest bit
toggled with every answer. Guard time (0x100C, ms) x life time factor (0x100D) after the last
question the node takes its master for dead. A node that produces a heartbeat is not guarded.
"""

from sim_rig.canopen.objects import Address, ObjectStore

GUARD_TIME: Address = (0x100C, 0)
LIFE_TIME_FACTOR: Address = (0x100D, 0)
_HEARTBEAT_TIME: Address = (0x1017, 0)
_TOGGLE = 0x80


class Guarding:
    """One node's side; `due_us` is when the life time ends, None while nobody guards."""

    def __init__(self, store: ObjectStore) -> None:
        self._store = store
        store.on_write(GUARD_TIME, self._anew)
        store.on_write(LIFE_TIME_FACTOR, self._anew)
        self.forget()

    def forget(self) -> None:
        """As after a reset of the communication: the first answer has the toggle bit 0."""
        self._toggle = 0
        self.due_us: int | None = None

    def answer(self, nmt_state: int, time_us: int) -> bytes | None:
        """The answer to a remote frame; None where the node is not guarded."""
        if self._store[_HEARTBEAT_TIME]:
            return None
        data = bytes([self._toggle | nmt_state])
        self._toggle ^= _TOGGLE
        life_us = self._store[GUARD_TIME] * self._store[LIFE_TIME_FACTOR] * 1000
        self.due_us = time_us + life_us if life_us else None
        return data

    def expired(self, now_us: int) -> bool:
        """Whether the life time has ended; told once."""
        if self.due_us is None or now_us < self.due_us:
            return False
        self.due_us = None
        return True

    def _anew(self, _value: int) -> None:
        # CiA 301: the watch begins with the first question heard, not with its configuration.
        self.due_us = None
