"""The shortest period that a drive on its line can hold, as a sum that can be checked by hand.

    RTU:  T = sum over transactions of [ (request + answer bytes) · t_char
                                         + 2 · max(t3.5, silent interval) + turnaround ]
    TCP:  T = sum over transactions of [ network round trip + turnaround ]

t_char is 10 or 11 bits long, t3.5 is 3.5 characters up to 19200 Bd and 1.75 ms above (Modbus over
serial line, V1.02). Each transaction has two silences: before the answer, and before the next
request. What the computer itself takes is not in the sum.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from drivers.errors import SettingsError
from drivers.modbus.frames import answer_bytes, request_bytes
from drivers.modbus.lines import Line, RtuLine
from drivers.modbus.plan import Exchange, Plan, plan_of
from drivers.modbus.profile import DriveProfile
from drivers.modbus.registers import Number

_RESOLUTION_S = 1e-9


@dataclass(frozen=True, slots=True)
class Term:
    """One part of the sum."""

    text: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Budget:
    """What a period is made of at the least."""

    terms: tuple[Term, ...]

    @property
    def total_s(self) -> float:
        """The shortest period."""
        return sum(term.seconds for term in self.terms)

    def __str__(self) -> str:
        parts = ", ".join(f"{term.text} = {_ms(term.seconds)}" for term in self.terms)
        return f"{parts}: {_ms(self.total_s)}"


def shortest_period(profile: DriveProfile, line: Line, plan: Plan | None = None) -> Budget:
    """The budget of a profile on a line, for its whole `[cycle]` or for a `plan` of it."""
    exchanges = (plan or plan_of(profile)).exchanges
    count, timing = len(exchanges), profile.timing
    turnaround = Term(_times(count, "turnaround", timing.turnaround_s), count * timing.turnaround_s)
    if not isinstance(line, RtuLine):
        network = Term(_times(count, "network", line.round_trip_s), count * line.round_trip_s)
        return Budget((network, turnaround))
    lengths = _lengths(profile, exchanges)
    total_bytes = sum(request + answer for request, answer in lengths)
    written = " and ".join(f"{request} + {answer}" for request, answer in lengths)
    silence_s = max(line.t35_s, timing.silent_interval_s)
    kind = "t3.5" if silence_s == line.t35_s else f"silent interval of {_ms(silence_s)}"
    return Budget(
        (
            Term(f"{written} bytes at {line.speed}", total_bytes * line.character_s),
            Term(f"{2 * count} x {kind}", 2 * count * silence_s),
            turnaround,
        )
    )


def check_period(profile: DriveProfile, line: Line, plan: Plan, period_s: float) -> Budget:
    """The budget, where it fits the period. SettingsError with the sum and what would hold."""
    budget = shortest_period(profile, line, plan)
    if budget.total_s <= period_s + _RESOLUTION_S:
        return budget
    raise SettingsError(
        f"{profile.title} on {line.name} cannot hold a period of {_ms(period_s)}: {budget} > "
        f"{_ms(period_s)}. {_what_holds(profile, line, plan, period_s, budget)}"
    )


def response_timeout_s(profile: DriveProfile, line: Line, exchange: Exchange) -> float:
    """After so long from the first byte of a request no answer to it can come any more."""
    longest_s = profile.timing.max_response_s
    if not isinstance(line, RtuLine):
        return line.round_trip_s + longest_s
    ((request, answer),) = _lengths(profile, (exchange,))
    silence_s = max(line.t35_s, profile.timing.silent_interval_s)
    return (request + answer) * line.character_s + 2 * silence_s + longest_s


def _what_holds(
    profile: DriveProfile, line: Line, plan: Plan, period_s: float, budget: Budget
) -> str:
    period = f"period_s >= {math.ceil(budget.total_s * 1e3 - 1e-6) * 1e-3:.3f}"
    if not isinstance(line, RtuLine):
        return f"Use {period}."
    for baud_rate in sorted(profile.timing.baud_rates):
        if baud_rate > line.baud_rate:
            faster = shortest_period(profile, replace(line, baud_rate=baud_rate), plan)
            if faster.total_s <= period_s + _RESOLUTION_S:
                return f"Use {baud_rate} Bd ({_ms(faster.total_s)}), or {period}."
    waiting_s = sum(term.seconds for term in budget.terms[1:])
    fastest = max((*profile.timing.baud_rates, line.baud_rate))
    if waiting_s > period_s:
        reason = f"its silences and turnaround alone take {_ms(waiting_s)}"
    else:
        reason = f"the drive takes {fastest} Bd at most"
    other = "Modbus TCP or CANopen" if "modbus-tcp" in profile.transports else "CANopen"
    return f"No speed of the line helps ({reason}): use {period}, or {other} where it has it."


def _lengths(profile: DriveProfile, exchanges: Sequence[Exchange]) -> list[tuple[int, int]]:
    zeros: dict[str, Number] = dict.fromkeys(profile.items, 0)
    longest = profile.functions.spare_read_words  # that many lost answers ask for the most words
    requests = [exchange.request(zeros, longest) for exchange in exchanges]
    return [(request_bytes(request), answer_bytes(request)) for request in requests]


def _times(count: int, what: str, seconds: float) -> str:
    return what if count == 1 else f"{count} x {what} of {_ms(seconds)}"


def _ms(seconds: float) -> str:
    return f"{round(seconds * 1e3, 1):g} ms"
