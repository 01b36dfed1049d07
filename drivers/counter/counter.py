"""A counter on a serial line: asked once in a slot, never waited for longer than its caller allows.

A count belongs to the slot whose request it answers, or to none:

1.  Where answers are not numbered, what has come before a request is sent is thrown away.
2.  Where answers are numbered, one goes to the slot that asked, and one that nobody has asked for
    is thrown away.
3.  Where they are not, one request is open at a time, given up only when the counter's longest
    response time has passed; and after one that was lost the next is asked for show: whatever
    comes in its slot comes to nobody, be it late or held back until somebody asked again.
4.  An answer later than the counter's longest response time is lost: when its count was taken,
    nobody knows.
5.  A wrong check sum, a character that is none, or a status that says so is a lost answer.

A lost answer is a slot without a load angle, counted and told; the one before is never repeated.
"""

import math
import os
import termios
from collections import Counter as Tally
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from drivers.canopen.scaling import Unwrapper
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.counter.index import IndexCheck
from drivers.counter.settings import CounterSettings
from drivers.errors import WireError
from drivers.modbus.link import readable
from drivers.modbus.watch import Watch
from drivers.serial_port import open_port, read_now

_READ_BYTES = 4096
_GREETINGS = 20
NO_ANSWER, LATE, DAMAGED = "no answer", "late", "damaged"
BUSY, FOR_SHOW = "line busy", "asked for show"


@dataclass(slots=True)
class Reading:
    """What a slot's request brought back; None where it did not.

    `sampled_ns` is when the count was taken, by the bytes on the line; `received_ns` when the last
    byte of the answer was read.
    """

    slot: int
    counts: int | None = None
    sampled_ns: int | None = None
    received_ns: int | None = None
    done: bool = False


@dataclass(slots=True)
class _Open:
    """A request that waits for its answer."""

    reading: Reading
    sequence: int
    sampled_ns: int
    give_up_ns: int
    damaged: bool = False
    for_show: bool = False
    heard: int = 0


class SerialCounter:
    """One counter; `open` first, `close` at last. Its events go to `watch`."""

    def __init__(
        self, settings: CounterSettings, watch: Watch, clock: Clock = SYSTEM_CLOCK
    ) -> None:
        self.name = settings.name
        self.rad_per_count = settings.direction * math.tau / settings.counts_per_revolution
        self.troubles: Tally[str] = Tally()
        self.strays = 0
        self._settings = settings
        self._profile = settings.profile
        self._asks, self._answers = settings.profile.asks, settings.profile.answers
        self._watch = watch
        self._clock = clock
        self._port: Any = None
        self._buffer = bytearray()
        self._unwrap = Unwrapper(settings.profile.range)
        self._index = IndexCheck(settings, watch)
        self._readings: deque[Reading] = deque()
        self._open: deque[_Open] = deque()  # of a counter without numbers one at the most
        self._suspects = False  # an answer is missing, and may still come
        self._sequence = 0
        self._last_good_ns = 0

    def open(self) -> None:
        """Open the line and have one answer. SettingsError or WireError where that cannot be."""
        line = self._settings.line
        self._port = open_port(
            line.device,
            line.baud_rate,
            data_bits=line.data_bits,
            parity=line.parity,
            stop_bits=line.stop_bits,
            table="encoder",
        )
        try:
            self._greet()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let go of the line; never raises."""
        port, self._port = self._port, None
        if port is not None:
            with suppress(OSError, termios.error):
                port.close()

    def ask(self, slot: int) -> None:
        """Send the slot's request, if the line is free for one. WireError when it is gone."""
        reading = Reading(slot)
        self._readings.append(reading)
        self.receive(0)
        if self._open and not self._profile.is_numbered:
            self._settle_without(reading, BUSY)
            return
        if self._suspects:
            self._settle_without(reading, FOR_SHOW)
        self._send(reading)

    def receive(self, until_ns: int) -> None:
        """Take what comes until nothing is open, or `until_ns`. WireError when the line is gone."""
        while self._open:
            self._parse()
            if not self._open:
                break
            give_up_ns = self._open[0].give_up_ns
            if self._wait(min(until_ns, give_up_ns)):
                self._read()
            elif self._clock.now_ns() >= give_up_ns:
                self._give_up()
            elif self._clock.now_ns() >= until_ns:
                break
        self._judge_silence()

    @property
    def is_waiting(self) -> bool:
        """Whether a request is open."""
        return bool(self._open)

    def settled(self) -> list[Reading]:
        """The readings that have settled since the last call, in the order of their slots."""
        done: list[Reading] = []
        while self._readings and self._readings[0].done:
            done.append(self._readings.popleft())
        return done

    def _greet(self) -> None:
        """Set up, and ask until one answer is good: the unwrapping begins with it."""
        for part in self._profile.set_up:
            self._write(part.literal)
            self._clock.sleep_s(
                len(part.literal) * self._settings.line.character_s + self._settings.give_up_s
            )
        self._last_good_ns = self._sequence = self._clock.now_ns()  # not a former master's number
        self._drain()
        for _ in range(_GREETINGS):
            reading = Reading(-1)
            self._send(reading)
            self.receive(self._clock.now_ns() + round(2 * self._settings.give_up_s * 1e9))
            while self._open:
                self._give_up()
            self._suspects = False
            if reading.counts is not None:
                self.troubles.clear()
                return
        seen = ", ".join(f"{count} x {what}" for what, count in self.troubles.items())
        raise WireError(
            f"{self.name} does not answer: asked {_GREETINGS} times at "
            f"{self._settings.line.speed} ({seen or NO_ANSWER}). Check its supply, the cable, "
            "speed and parity, and that it speaks what encoder.profile says "
            f"({self._profile.title})."
        )

    def _send(self, reading: Reading) -> None:
        if not self._profile.is_numbered:
            self._drain()
        self._sequence = (self._sequence + 1) % (self._answers.modulus("sequence") or 1)
        sent_ns = self._clock.now_ns()
        self._write(self._asks.encode({"sequence": self._sequence}))
        settings = self._settings
        self._open.append(
            _Open(
                reading,
                self._sequence,
                sent_ns + round(settings.sampled_after_s * 1e9),
                sent_ns + round(settings.give_up_s * 1e9),
                for_show=self._suspects,
            )
        )

    def _write(self, data: bytes) -> None:
        try:
            taken = os.write(self._port.fileno(), data)
        except OSError as error:
            raise self._gone(error) from error
        if taken != len(data):
            raise self._gone("it takes no more bytes")

    def _wait(self, until_ns: int) -> bool:
        return readable(self._port.fileno(), until_ns, self._clock)

    def _read(self) -> None:
        data = read_now(self._port, _READ_BYTES, self._gone)
        self._buffer += data
        del self._buffer[: -4 * self._answers.size]

    def _drain(self) -> None:
        """Throw away what belongs to no open request."""
        if self._wait(0):
            self._read()
        if self._buffer:
            self.strays += 1
            self._buffer.clear()

    def _parse(self) -> None:
        """Settle the open requests whose answers are in the buffer whole."""
        size, buffer = self._answers.size, self._buffer
        while self._open and len(buffer) >= size:
            values = self._answers.decode(bytes(buffer[:size]))
            if values is None:
                self._open[0].damaged = True
                del buffer[0]
                continue
            del buffer[:size]
            sequence = values.get("sequence", self._sequence)
            waiting = next((it for it in self._open if it.sequence == sequence), None)
            if waiting is None or waiting.for_show:
                self.strays += 1
                self._open[0].heard += 1
            else:
                self._open.remove(waiting)
                self._take(waiting, values)

    def _take(self, waiting: _Open, values: dict[str, int]) -> None:
        now_ns = self._clock.now_ns()
        if now_ns > waiting.give_up_ns:
            self._settle_without(waiting.reading, LATE)
            return
        status = self._profile.status
        if status is not None and status.fault.hold(values["status"]):
            self._settle_without(waiting.reading, f"status 0x{values['status']:02X}, {status.text}")
            return
        reading = waiting.reading
        reading.counts = self._unwrap(values["position"])
        reading.sampled_ns, reading.received_ns = waiting.sampled_ns, now_ns
        self._last_good_ns = now_ns
        self._index.look(now_ns, values, reading.counts)
        reading.done = True

    def _give_up(self) -> None:
        """The answer to the oldest open request has not come, or not as it should."""
        waiting = self._open.popleft()
        self._suspects = not (waiting.damaged or waiting.heard or self._profile.is_numbered)
        if waiting.for_show:
            return
        self._settle_without(waiting.reading, DAMAGED if waiting.damaged else NO_ANSWER)

    def _settle_without(self, reading: Reading, what: str) -> None:
        reading.done = True
        self.troubles[what] += 1
        if reading.slot >= 0:
            self._watch.tell(
                self._clock.now_ns(),
                "load sample lost",
                f"{self.name}: slot {reading.slot} has no load angle ({what}).",
            )

    def _judge_silence(self) -> None:
        now_ns = self._clock.now_ns()
        silent_s = (now_ns - self._last_good_ns) * 1e-9
        if silent_s > self._settings.silence_s and self._readings:
            seen = ", ".join(f"{count} x {what}" for what, count in self.troubles.items())
            self._watch.tell(
                now_ns,
                "load encoder silent",
                f"{self.name} has given no good answer for {silent_s:.2f} s ({seen}). Check its "
                "supply, the cable, and the encoder's signals.",
                fatal=True,
            )

    def begin(self) -> None:
        """The run begins now: silence is counted from here."""
        self._last_good_ns = self._clock.now_ns()

    def _gone(self, reason: object) -> WireError:
        return WireError(f"{self.name} is gone: {reason}. Check the adapter and the cable.")
