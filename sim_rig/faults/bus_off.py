"""Bus-off: for a while nothing gets through, in either direction, whatever the session does."""

from sim_rig.faults.fault import Fault, Frame


class BusOff(Fault):
    """All frames are gone from SYNC `at` on, for `for_ms` (0: for ever)."""

    until_us: int | None = None

    def begin(self) -> None:
        """Off."""
        duration_us = round(float(self.values["for_ms"]) * 1000)
        self.until_us = self.now_us + duration_us if duration_us else 1 << 62

    def incoming(self, frame: Frame) -> list[Frame]:
        """Nothing, while it is off."""
        return [] if self._off else [frame]

    def outgoing(self, frame: Frame) -> list[Frame]:
        """Nothing, while it is off."""
        return [] if self._off else [frame]

    @property
    def _off(self) -> bool:
        return self.until_us is not None and self.now_us < self.until_us
