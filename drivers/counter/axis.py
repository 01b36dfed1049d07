"""Any drive's axis with the load's angle from a serial counter beside it.

    command:  the drive's command and ask, then the counter's request
    samples:  the drive's answers, then the counter's, neither waited for beyond the caller's time
    enter:    the counter answers first, only then is the drive enabled
    leave:    the drive is stopped first, whatever the counter does

Both share a slot's sample: the drive's part at the ask, the load's `load_sampled_ns` after it.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from types import TracebackType
from typing import Self

from drivers.axis import Axis, Sample, WireEvent
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.counter.counter import Reading, SerialCounter
from drivers.counter.settings import CounterSettings
from drivers.modbus.watch import Watch
from drivers.plausible import Plausibility

_LOOK_NS = 250_000
"""While both are waited for they are looked at in turn: an answer is stamped when it is read."""


class AxisWithCounter:
    """See `drivers.axis.Axis`; raises what the drive's axis raises, and WireError for the counter.

    A counter that falls silent is a fatal event, one that is unplugged a WireError.
    """

    def __init__(self, axis: Axis, settings: CounterSettings, clock: Clock = SYSTEM_CLOCK) -> None:
        self._axis = axis
        self._settings = settings
        self._clock = clock
        self._reset()

    def _reset(self) -> None:
        self._watch = Watch()
        self._counter = SerialCounter(self._settings, self._watch, self._clock)
        self._plausible = Plausibility(
            self._settings.stuck_travel_rad, self._settings.name, self._cannot_be
        )
        self._outstanding = 0  # slots that the drive has not answered
        self._samples: deque[Sample] = deque()
        self._readings: deque[Reading] = deque()

    def __enter__(self) -> Self:
        self._reset()
        self._counter.open()
        try:
            self._axis.__enter__()
        except BaseException:
            self._counter.close()
            raise
        self._counter.begin()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._axis.__exit__(kind, error, trace)
        finally:
            self._counter.close()

    @property
    def may_be_powered(self) -> bool:
        """As the drive's axis."""
        return self._axis.may_be_powered

    def command(self, velocity_rad_s: float, slot: int) -> int:
        """As the drive's axis; the counter is asked right after it."""
        asked_ns = self._axis.command(velocity_rad_s, slot)
        self._outstanding += 1
        self._counter.ask(slot)
        return asked_ns

    def samples(self, until_ns: int) -> Sequence[Sample]:
        """Samples of which both parts have settled, in slot order."""
        while self._counter.is_waiting and (now_ns := self._clock.now_ns()) < until_ns:
            look_ns = min(until_ns, now_ns + _LOOK_NS)
            self._hear(look_ns)
            self._counter.receive(look_ns if self._outstanding else until_ns)
        self._hear(until_ns)
        self._counter.receive(0)
        self._readings.extend(self._counter.settled())
        whole: list[Sample] = []
        while self._samples and self._readings:
            whole.append(self._joined(self._samples.popleft(), self._readings.popleft()))
        return whole

    def finish(self) -> Sequence[Sample]:
        """As the drive's axis, with the load's angle where it has come."""
        self._samples.extend(self._axis.finish())
        self._readings.extend(self._counter.settled())
        self._watch.tell_totals(self._clock.now_ns())
        joined = [
            self._joined(sample, reading)
            for sample, reading in zip(self._samples, self._readings, strict=False)
        ]
        alone = list(self._samples)[len(joined) :]
        self._samples.clear()
        self._readings.clear()
        self._outstanding = 0
        return [*joined, *alone]

    def _hear(self, until_ns: int) -> None:
        samples = self._axis.samples(until_ns)
        self._outstanding -= len(samples)
        self._samples.extend(samples)

    def events(self) -> Sequence[WireEvent]:
        """What else happened, on the drive's wire and on the counter's."""
        return [*self._axis.events(), *self._watch.drain()]

    def _joined(self, sample: Sample, reading: Reading) -> Sample:
        if reading.counts is None:
            return sample
        load_rad = reading.counts * self._counter.rad_per_count
        counts, motor_rad = sample.motor_position_counts, sample.motor_position_rad
        if counts is not None and motor_rad is not None:
            # the motor stands in for its command, which the drive's own axis compares it with
            self._plausible.look(
                sample.asked_ns * 1e-9, motor_rad, (counts, motor_rad), (reading.counts, load_rad)
            )
        return replace(
            sample,
            encoder_answered_ns=reading.received_ns,
            load_sampled_ns=reading.sampled_ns,
            load_angle_counts=reading.counts,
            load_angle_rad=load_rad,
        )

    def _cannot_be(self, kind: str, text: str) -> None:
        self._watch.tell(self._clock.now_ns(), kind, text, fatal=True)
