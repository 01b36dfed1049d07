"""Faults to order on a serial counter, one line each: `kind name=value ...`.

    counter-lost        the answer never comes
    counter-damaged     one byte of the answer is wrong
    counter-late        the answer comes delay_ms later; those behind it wait
    counter-stuck       the count stays what it was
    counter-jump        the count is off by `counts` from then on
    counter-fault       the status says that the count cannot be trusted
    counter-unplugged   the line is cut, for good

They begin at request `at`, counted from 0 since the drive was enabled, and last for `count` (0: to
the end). `rate` is the share of the requests that are hit, drawn from the rig's seed.
"""

from dataclasses import dataclass
from types import MappingProxyType

from sim_rig.errors import RigSettingsError

PREFIX = "counter-"
KINDS = MappingProxyType(
    {
        "counter-lost": "the counter's answer never comes",
        "counter-damaged": "one byte of the counter's answer is wrong",
        "counter-late": "the counter's answer comes delay_ms later",
        "counter-stuck": "the counter's count stays",
        "counter-jump": "the counter's count jumps by counts",
        "counter-fault": "the counter's status says that its count cannot be trusted",
        "counter-unplugged": "the counter's line is cut, for good",
    }
)
_LASTING = frozenset({"counter-stuck", "counter-jump", "counter-fault", "counter-unplugged"})
_OWN = {"counter-late": ("delay_ms",), "counter-jump": ("counts",)}


@dataclass(frozen=True, slots=True)
class Order:
    """One fault."""

    kind: str
    at: int = 50
    count: int = 1
    rate: float = 1.0
    delay_ms: float = 5.0
    counts: int = 1000

    def hits(self, request: int) -> bool:
        """Whether this request lies in the fault's time."""
        return self.at <= request and (self.count == 0 or request < self.at + self.count)


def names_of(kind: str) -> tuple[str, ...]:
    """What a kind may be told."""
    return "at", "count", "rate", *_OWN.get(kind, ())


def default(kind: str) -> Order:
    """The fault as it is without any value."""
    return Order(kind, count=0 if kind in _LASTING else 1)


def parse(line: str) -> Order:
    """An order from its line. RigSettingsError where there is no such kind, name, or value."""
    kind, *words = line.split() or [""]
    if kind not in KINDS:
        raise RigSettingsError(
            f"fault {line!r}: there is no {kind!r} on a counter. There are {', '.join(KINDS)}."
        )
    order = default(kind)
    values: dict[str, int | float] = {}
    for word in words:
        name, _, text = word.partition("=")
        if name not in names_of(kind):
            raise RigSettingsError(
                f"fault {line!r}: {kind} has no {name!r}; it has {', '.join(names_of(kind))}."
            )
        try:
            values[name] = float(text) if name in ("rate", "delay_ms") else int(text, 0)
        except ValueError as error:
            raise RigSettingsError(f"fault {line!r}: {word} is no number.") from error
    made = Order(
        kind,
        at=int(values.get("at", order.at)),
        count=int(values.get("count", order.count)),
        rate=values.get("rate", order.rate),
        delay_ms=values.get("delay_ms", order.delay_ms),
        counts=int(values.get("counts", order.counts)),
    )
    if made.at < 0 or made.count < 0 or not 0.0 <= made.rate <= 1.0:
        raise RigSettingsError(f"fault {line!r}: at and count are 0 or more, rate is 0 to 1.")
    if not 0.0 <= made.delay_ms <= 10_000.0:
        raise RigSettingsError(f"fault {line!r}: delay_ms is 0 to 10000.")
    return made
