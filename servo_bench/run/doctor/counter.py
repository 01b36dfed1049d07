"""The load's counter on its serial line: does it answer, how soon, and does it count the same?"""

from statistics import median

from drivers.clock import SYSTEM_CLOCK
from drivers.counter.counter import Reading, SerialCounter
from drivers.counter.settings import CounterSettings, sum_of
from drivers.modbus.watch import Watch
from servo_bench.errors import gathered
from servo_bench.run.finding import Finding, change, note, ok

READS = 50
FEW_LOST = 0.02
"""What a shared machine may cost without a fault of the line."""


def examine(settings: CounterSettings) -> list[Finding]:
    """Line, answers, standstill, what its framing can see. WireError where nobody answers."""
    counter = SerialCounter(settings, Watch())
    with gathered():
        counter.open()
        try:
            readings = [_asked(counter, settings, slot) for slot in range(READS)]
        finally:
            counter.close()
    good = [it for it in readings if it.counts is not None]
    return [_line(counter, settings, readings, good), *_counts(good), _framing(settings)]


def _asked(counter: SerialCounter, settings: CounterSettings, slot: int) -> Reading:
    begun_ns = SYSTEM_CLOCK.now_ns()
    end_ns = begun_ns + round(settings.period_s * 1e9)
    counter.ask(slot)
    counter.receive(end_ns)
    SYSTEM_CLOCK.sleep_until(end_ns)
    counter.receive(0)
    settled = counter.settled()
    return settled[-1] if settled else Reading(slot)


def _line(
    counter: SerialCounter,
    settings: CounterSettings,
    readings: list[Reading],
    good: list[Reading],
) -> Finding:
    took_s = [
        (it.received_ns - it.sampled_ns) * 1e-9 + settings.sampled_after_s
        for it in good
        if it.received_ns is not None and it.sampled_ns is not None
    ]
    lost = len(readings) - len(good)
    seen = ", ".join(f"{count} x {what}" for what, count in counter.troubles.items())
    text = (
        f"{settings.profile.title} on {settings.line.name}: "
        f"{median(took_s) * 1e3 if took_s else 0.0:.2f} ms from request to answer at the median, "
        f"by the bytes {sum_of(settings.profile, settings.line)}; {lost} of {len(readings)} lost"
    )
    if lost > FEW_LOST * len(readings):
        return change(
            "load counter",
            f"{text} ({seen}). Check cable, shield, and speed; a USB adapter's latency_timer must "
            "read 1.",
        )
    return ok("load counter", f"{text}.")


def _counts(good: list[Reading]) -> list[Finding]:
    counts = [it.counts for it in good if it.counts is not None]
    if not counts:
        return []
    span = max(counts) - min(counts)
    return [note("load counts", f"at {counts[-1]} counts, {span} counts of movement meanwhile.")]


def _framing(settings: CounterSettings) -> Finding:
    profile = settings.profile
    lacks = []
    if not profile.answers.is_checked:
        lacks.append("no check sum: a wrong digit cannot be seen but by its size")
    if not profile.is_numbered:
        lacks.append("no number: a lost answer costs two slots")
    if "index" not in profile.answers.fields:
        lacks.append("no index: lost counts show only beside the motor's encoder")
    if not lacks:
        return ok("counter's framing", "check sum, number, and index.")
    return note("counter's framing", f"{'; '.join(lacks)}.")
