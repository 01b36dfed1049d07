"""Faults to order on Modbus, one line each: `kind name=value ...`, e.g. `exception at=100 code=6`.

    lost         the answer never comes; the drive has done what it was told
    late         the answer comes with the next one, before it
    duplicated   the answer comes twice
    damaged      a wrong check sum, or on TCP another transaction's id
    exception    an exception reply with `code` in place of the answer
    unplugged    the serial line is cut, or on TCP nothing comes through any more, for good

They begin at request `at`, counted from 0 since the drive was enabled, and last for `count`.
"""

from dataclasses import dataclass

from sim_rig.errors import RigSettingsError

KINDS = ("lost", "late", "duplicated", "damaged", "exception", "unplugged")


@dataclass(frozen=True, slots=True)
class Order:
    """One fault."""

    kind: str
    at: int = 50
    count: int = 1
    code: int = 4

    def hits(self, request: int) -> bool:
        """Whether the fault is at work at this request."""
        return self.at <= request < self.at + self.count


def parse(line: str) -> Order:
    """An order from its line. RigSettingsError where there is no such kind, name, or value."""
    kind, *words = line.split() or [""]
    if kind not in KINDS:
        raise RigSettingsError(
            f"fault {line!r}: there is no {kind!r} on Modbus. There are {', '.join(KINDS)}."
        )
    values: dict[str, int] = {}
    for word in words:
        name, _, text = word.partition("=")
        if name not in ("at", "count", "code") or (name == "code") > (kind == "exception"):
            raise RigSettingsError(f"fault {line!r}: {kind} has no {name!r}; it has at and count.")
        try:
            values[name] = int(text, 0)
        except ValueError as error:
            raise RigSettingsError(f"fault {line!r}: {word} is no whole number.") from error
    order = Order(kind, **values)
    if order.at < 0 or order.count < 1 or not 1 <= order.code <= 255:
        raise RigSettingsError(f"fault {line!r}: at is 0 or more, count 1 or more, code 1 to 255.")
    return order
