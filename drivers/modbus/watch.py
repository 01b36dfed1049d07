"""What happens beside the samples: kept until it is drained, each kind once where it repeats."""

from drivers.axis import WireEvent

_TOLD = 8


class Watch:
    """Events of one axis; `first_fatal` is what ended the trust in it."""

    def __init__(self) -> None:
        self.first_fatal: WireEvent | None = None
        self._events: list[WireEvent] = []
        self._counts: dict[str, int] = {}

    def tell(self, now_ns: int, kind: str, text: str, *, fatal: bool = False) -> None:
        """Add an event. The first of a kind that is fatal is told, of others the first eight."""
        count = self._counts.get(kind, 0) + 1
        self._counts[kind] = count
        if count > (1 if fatal else _TOLD):
            return
        if count == _TOLD:
            text += " Further ones are counted, not told."
        event = WireEvent(now_ns, kind, text, fatal)
        self._events.append(event)
        if fatal and self.first_fatal is None:
            self.first_fatal = event

    def tell_totals(self, now_ns: int) -> None:
        """Tell how many there were of the kinds that were counted only at last."""
        for kind, count in self._counts.items():
            if count > _TOLD:
                text = f"{count} in all, of which the first {_TOLD} were told."
                self._events.append(WireEvent(now_ns, kind, text))

    def count(self, kind: str) -> int:
        """How many of a kind there have been."""
        return self._counts.get(kind, 0)

    def drain(self) -> list[WireEvent]:
        """Everything since the last call."""
        events, self._events = self._events, []
        return events
