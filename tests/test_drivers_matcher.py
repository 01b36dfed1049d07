"""The matcher against a simulated channel: a FIFO that loses, delays, bunches, and repeats.

The payload of an answer is the slot it truly belongs to, so every pairing can be judged.
"""

from dataclasses import dataclass, field
from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.canopen.matcher import Matcher, Settled

PERIOD, TIMEOUT = 8, 250
SLOTS = 120


@dataclass
class Channel:
    """Asks every PERIOD; answer k leaves at its ask plus `delay[k]`, in order, unless `lost`.

    `stalls` are (begin, end): nothing arrives between, everything at the end. `repeated` answers
    arrive twice.
    """

    delay: dict[int, int] = field(default_factory=dict)
    lost: frozenset[int] = frozenset()
    repeated: frozenset[int] = frozenset()
    stalls: list[tuple[int, int]] = field(default_factory=list)

    def arrivals(self) -> list[tuple[int, int]]:
        arrived, last = [], 0
        for slot in range(SLOTS):
            if slot in self.lost:
                continue
            at = max(last, slot * PERIOD + self.delay.get(slot, 1))
            for begin, end in self.stalls:
                if begin <= at < end:
                    at = end
            last = at
            arrived += [(at, slot)] * (1 + (slot in self.repeated))
        return arrived

    def run(self) -> tuple[list[Settled[int]], list[int]]:
        """Play it through a matcher: what settled, and what nobody had asked for."""
        matcher: Matcher[int] = Matcher(TIMEOUT)
        waiting = self.arrivals()
        unasked = []

        def take(before: int) -> None:
            while waiting and waiting[0][0] < before:
                at, slot = waiting.pop(0)
                if not matcher.answer(slot, at):
                    unasked.append(slot)
            matcher.give_up(before)

        for slot in range(SLOTS):
            take(slot * PERIOD)
            matcher.ask(slot, slot * PERIOD)
        end = SLOTS * PERIOD
        while end < SLOTS * PERIOD + 4 * TIMEOUT:
            take(end)
            end += PERIOD
        assert matcher.missing == 0
        return list(matcher.settled), unasked


def truly_paired(settled: list[Settled[int]], lost: frozenset[int]) -> bool:
    return [s.payload for s in settled] == [k if k not in lost else None for k in range(SLOTS)]


slots = st.integers(0, SLOTS - 1)
prompt = st.dictionaries(slots, st.integers(0, PERIOD - 1))


@given(delay=prompt, lost=st.frozensets(slots, max_size=40))
def test_prompt_answers_are_paired_exactly_however_many_are_lost(
    delay: dict[int, int], lost: frozenset[int]
) -> None:
    settled, unasked = Channel(delay=delay, lost=lost).run()
    assert truly_paired(settled, lost)
    assert not unasked


@given(
    delay=prompt,
    gaps=st.lists(st.tuples(st.integers(2 * PERIOD, 20 * PERIOD), st.integers(1, TIMEOUT // 2))),
)
def test_late_bursts_are_paired_exactly_when_nothing_is_lost(
    delay: dict[int, int], gaps: list[tuple[int, int]]
) -> None:
    stalls, now = [], 0
    for gap, duration in gaps:
        stalls.append((now + gap, now + gap + duration))
        now += gap + duration
    settled, unasked = Channel(delay=delay, stalls=stalls).run()
    assert truly_paired(settled, frozenset())
    assert not unasked


@given(
    lost=st.integers(1, SLOTS // 2),
    prompt_after=st.integers(1, 35),
    duration=st.integers(1, TIMEOUT // 2),
)
def test_a_stall_after_a_loss_does_not_shift_the_pairs(
    lost: int, prompt_after: int, duration: int
) -> None:
    begin = (lost + prompt_after) * PERIOD + 2
    channel = Channel(lost=frozenset({lost}), stalls=[(begin, begin + duration)])
    settled, unasked = channel.run()
    assert truly_paired(settled, channel.lost)
    assert not unasked


@given(
    lost=st.integers(1, SLOTS // 2),
    prompt_after=st.integers(1, 35),
    lagging=st.integers(1, 10),
    lag=st.integers(PERIOD, 6 * PERIOD),
)
def test_a_lag_while_a_loss_is_still_open_does_not_shift_the_pairs(
    lost: int, prompt_after: int, lagging: int, lag: int
) -> None:
    begin = lost + prompt_after
    delay = dict.fromkeys(range(begin, begin + lagging), lag)
    channel = Channel(lost=frozenset({lost}), delay=delay)
    settled, unasked = channel.run()
    assert truly_paired(settled, channel.lost)
    assert not unasked


@settings(max_examples=200)
@given(
    delay=st.dictionaries(slots, st.integers(0, 2 * TIMEOUT)),
    lost=st.frozensets(slots),
    repeated=st.frozensets(slots),
    stalls=st.lists(st.tuples(st.integers(0, SLOTS * PERIOD), st.integers(1, 2 * TIMEOUT))),
)
def test_whatever_happens_every_ask_settles_once_in_order_and_causally(
    delay: dict[int, int],
    lost: frozenset[int],
    repeated: frozenset[int],
    stalls: list[tuple[int, int]],
) -> None:
    spans = sorted((begin, begin + duration) for begin, duration in stalls)
    channel = Channel(delay=delay, lost=lost, repeated=repeated, stalls=spans)
    settled, unasked = channel.run()
    assert [s.slot for s in settled] == list(range(SLOTS))
    paired = [s for s in settled if s.payload is not None]
    assert all(s.received_ns is not None and s.received_ns >= s.asked_ns for s in paired)
    assert all((a.payload or 0) <= (b.payload or 0) for a, b in pairwise(paired))
    assert len(paired) + len(unasked) == len(channel.arrivals())


def test_an_answer_that_nobody_asked_for_is_refused() -> None:
    matcher: Matcher[str] = Matcher(TIMEOUT)
    assert not matcher.answer("early", 0)
    matcher.ask(0, 1)
    assert matcher.answer("right", 2)
    assert not matcher.answer("again", 3)
    assert [s.payload for s in matcher.settled] == ["right"]


def test_total_silence_settles_each_ask_when_its_own_time_is_over() -> None:
    matcher: Matcher[str] = Matcher(TIMEOUT)
    for slot in range(4):
        matcher.ask(slot, slot * 100)
    matcher.give_up(TIMEOUT)
    assert not matcher.settled
    matcher.give_up(TIMEOUT + 101)
    assert [(s.slot, s.payload) for s in matcher.settled] == [(0, None), (1, None)]
    assert matcher.missing == 2
