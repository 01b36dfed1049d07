"""What the bench must be told about a serial counter, and whether its line holds the period.

    T = (request + answer bytes) · t_char + turnaround          t_char: 9 to 12 bits

A count must also not run over unseen: the load may turn, while answers are missing, by less than
half of the counter's range.
"""

import math
from dataclasses import dataclass
from typing import Literal

from drivers.counter.profile import CounterProfile, Parity
from drivers.errors import SettingsError

_RESOLUTION_S = 1e-9


@dataclass(frozen=True, slots=True)
class CounterLine:
    """The serial device and its characters."""

    device: str
    baud_rate: int = 115200
    data_bits: Literal[7, 8] = 8
    parity: Parity = "N"
    stop_bits: Literal[1, 2] = 1

    @property
    def name(self) -> str:
        """For messages."""
        return f"{self.device} at {self.speed}"

    @property
    def speed(self) -> str:
        """Speed and character, as in "115200 Bd 8N1"."""
        return f"{self.baud_rate} Bd {self.data_bits}{self.parity}{self.stop_bits}"

    @property
    def character_s(self) -> float:
        """Start bit, data bits, parity if any, stop bits."""
        bits = 1 + self.data_bits + (self.parity != "N") + self.stop_bits
        return bits / self.baud_rate


@dataclass(frozen=True, slots=True)
class CounterSettings:
    """One counter: line, profile, scale, and the period in which it is asked once.

    `fastest_rad_s` is the fastest that the load may turn. `answer_timeout_s` without any good
    answer ends the trust in the counter. `stuck_travel_rad`: see `drivers.plausible`.
    Raises SettingsError for what this counter on this line cannot do.
    """

    line: CounterLine
    profile: CounterProfile
    counts_per_revolution: int
    period_s: float
    fastest_rad_s: float
    direction: Literal[1, -1] = 1
    answer_timeout_s: float = 0.25
    stuck_travel_rad: float = math.radians(10.0)

    def __post_init__(self) -> None:
        line, profile = self.line, self.profile
        if not line.device or line.baud_rate < 300:
            raise SettingsError(
                f"encoder.device = {line.device!r}, encoder.baud_rate = {line.baud_rate}: a "
                'counter needs a serial device and its speed, e.g. device = "/dev/ttyUSB1", '
                "baud_rate = 115200."
            )
        if self.shortest_period_s > self.period_s + _RESOLUTION_S:
            raise SettingsError(
                f"{profile.title} on {line.name} cannot be asked every {_ms(self.period_s)}: "
                f"{sum_of(profile, line)}. {self._what_holds()}"
            )
        blind_s = self.silence_s + self.period_s
        counts = self.fastest_rad_s * blind_s * self.counts_per_revolution / math.tau
        if counts >= profile.range / 2:
            raise SettingsError(
                f"{profile.title} counts to {profile.range} and runs over; at "
                f"{math.degrees(self.fastest_rad_s):.6g} deg/s (limits.velocity_deg_s) the load "
                f"turns by {counts:.0f} of its counts in the {blind_s:g} s in which answers may be "
                f"missing, allowed is half the range. Lower the limit, or take a wider counter."
            )

    @property
    def name(self) -> str:
        """For messages."""
        return f"the counter on {self.line.device}"

    @property
    def request_s(self) -> float:
        """How long a request is on the line."""
        return self.profile.asks.size * self.line.character_s

    @property
    def answer_s(self) -> float:
        """How long an answer is on the line."""
        return self.profile.answers.size * self.line.character_s

    @property
    def shortest_period_s(self) -> float:
        """The sum."""
        return self.request_s + self.profile.timing.turnaround_s + self.answer_s

    @property
    def sampled_after_s(self) -> float:
        """From the request's first bit to the instant at which the count is taken."""
        return self.request_s + self.profile.timing.latch_s

    @property
    def give_up_s(self) -> float:
        """After so long from the request's first bit no answer to it can come any more."""
        return self.request_s + self.profile.timing.max_response_s + self.answer_s

    @property
    def silence_s(self) -> float:
        """The longest time without a good answer."""
        return max(self.answer_timeout_s, 3 * self.give_up_s, 3 * self.period_s)

    def _what_holds(self) -> str:
        period = f"period_s >= {math.ceil(self.shortest_period_s * 1e3 - 1e-6) * 1e-3:.3f}"
        left_s = self.period_s - self.profile.timing.turnaround_s
        bits = (self.request_s + self.answer_s) * self.line.baud_rate
        fast = [rate for rate in self.profile.line.baud_rates if 0.0 < bits / rate <= left_s]
        if not fast:
            return f"No speed that it has helps: use {period}, or another counter."
        return f"Set it to {min(fast)} Bd, or use {period}."


def sum_of(profile: CounterProfile, line: CounterLine) -> str:
    """The shortest period of a profile on a line, as a sum in words."""
    request, answer = profile.asks.size, profile.answers.size
    bytes_s, turnaround_s = (request + answer) * line.character_s, profile.timing.turnaround_s
    return (
        f"{request} + {answer} bytes at {line.speed} = {_ms(bytes_s)}, turnaround = "
        f"{_ms(turnaround_s)}: {_ms(bytes_s + turnaround_s)}"
    )


def _ms(seconds: float) -> str:
    return f"{round(seconds * 1e3, 2):g} ms"
