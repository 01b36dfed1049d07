"""The index pulse: where the shaft's zero is, and whether counts were lost since the last one.

Two index pulses are a whole number of revolutions apart, whatever was counted between them:

    latch(n) - latch(1) = k · counts per revolution          within TOLERANCE counts
"""

from collections.abc import Mapping

from drivers.counter.settings import CounterSettings
from drivers.modbus.watch import Watch

TOLERANCE = 4


class IndexCheck:
    """Looks at every good answer of a counter whose profile has an index."""

    def __init__(self, settings: CounterSettings, watch: Watch) -> None:
        self._name = settings.name
        self._per_revolution = settings.counts_per_revolution
        self._range = settings.profile.range
        self._watch = watch
        self._number: int | None = None
        self._first: int | None = None

    def look(self, now_ns: int, values: Mapping[str, int], counts: int) -> None:
        """An answer's numbers, and its unwrapped count."""
        number = values.get("index_number")
        if number is None:
            return
        before, self._number = self._number, number
        if before is None or number == before:
            return
        latched = counts - self._behind(values["position"], values["index"])
        if self._first is None:
            self._first = latched
            self._watch.tell(
                now_ns,
                "index",
                f"{self._name}: the index is at {latched} counts (load_angle_counts).",
            )
            return
        off = self._off(latched - self._first)
        if abs(off) > TOLERANCE:
            self._watch.tell(
                now_ns,
                "index disagrees",
                f"{self._name}: two index pulses are {latched - self._first} counts apart, which "
                f"is {off:+d} off a whole number of revolutions of {self._per_revolution} "
                f"(allowed {TOLERANCE}): counts were lost, or encoder.counts_per_revolution is "
                "wrong. Check signals, speed, and shield.",
                fatal=True,
            )

    def _behind(self, position: int, index: int) -> int:
        """How many counts the shaft has gone since the latch, across the end of the range."""
        half = self._range // 2
        return (position - index + half) % self._range - half

    def _off(self, apart: int) -> int:
        half = self._per_revolution // 2
        return (apart + half) % self._per_revolution - half
