"""A slave that produces SYNC: bit 30 of 0x1005 switches it on, 0x1006 is the period in us."""

from sim_rig.canopen.objects import Abort, Address, ObjectStore, refuse

SYNC_COB_ID: Address = (0x1005, 0)
SYNC_PERIOD: Address = (0x1006, 0)
_PRODUCES = 1 << 30
_IDENTIFIER = 0x7FF


class SyncProducer:
    """When a node's next SYNC is due; `due_us` is None while it produces none."""

    def __init__(self, store: ObjectStore) -> None:
        self._store = store
        self._now_us = 0
        self.due_us: int | None = None
        store.on_write(SYNC_COB_ID, self._switch)
        store.on_write(SYNC_PERIOD, self._change_period)

    @property
    def produces(self) -> bool:
        """Whether bit 30 is set."""
        return bool(self._store[SYNC_COB_ID] & _PRODUCES)

    @property
    def cob_id(self) -> int:
        """The identifier of SYNC, its own or another's."""
        return self._store[SYNC_COB_ID] & _IDENTIFIER

    def see_time(self, time_us: int) -> None:
        """What time it is when the next object is written."""
        self._now_us = time_us

    def forget(self) -> None:
        """As after a reset: nothing is produced."""
        self.due_us = None

    def is_due(self, now_us: int) -> bool:
        """Whether a SYNC goes out now; the next one is due a period later on the same grid."""
        if self.due_us is None or now_us < self.due_us:
            return False
        period_us = self._store[SYNC_PERIOD]
        self.due_us = max(self.due_us + period_us, now_us) if period_us else None
        return True

    def _switch(self, value: int) -> None:
        identifier, others = value & _IDENTIFIER, value & ~(_PRODUCES | _IDENTIFIER)
        if others or not identifier:
            raise refuse(Abort.INVALID_VALUE)
        if self.produces and value & _PRODUCES and identifier != self.cob_id:
            raise refuse(Abort.INVALID_VALUE)  # CiA 301: not while it exists
        period_us = self._store[SYNC_PERIOD]
        self.due_us = self._now_us + period_us if value & _PRODUCES and period_us else None

    def _change_period(self, period_us: int) -> None:
        self.due_us = self._now_us + period_us if self.produces and period_us else None
