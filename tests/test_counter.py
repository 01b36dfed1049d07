"""The serial counter's master against a scripted peer: a count is the slot's own, or none."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

from drivers.axis import Sample, WireEvent
from drivers.counter.axis import AxisWithCounter
from drivers.counter.counter import SerialCounter
from drivers.counter.profile import CounterProfile, load_profile
from drivers.counter.settings import CounterLine, CounterSettings
from drivers.errors import DriveError, WireError
from drivers.modbus.watch import Watch
from tests.counter_peer import Act, Peer, binary_answer

PERIOD_S, PERIOD_NS = 0.008, 8_000_000
BINARY = load_profile("generic-binary")
NARROW = """
title = "16 bits, no number"
request = [{ text = "?" }]
answer = [{ text = "=" }, { field = "position", bytes = 2 }, { check = "xor8" }]
"""


@dataclass
class Bench:
    """A counter that is open, and its peer."""

    counter: SerialCounter
    watch: Watch
    peer: Peer

    def play(self, slots: range) -> dict[int, int | None]:
        """Ask in every slot; the counts."""
        counts: dict[int, int | None] = {}
        for slot in slots:
            end_ns = self.peer.now_ns + PERIOD_NS
            self.counter.ask(slot)
            self.counter.receive(end_ns - 500_000)
            self.peer.now_ns = max(self.peer.now_ns, end_ns)
            counts |= {it.slot: it.counts for it in self.counter.settled()}
        return counts

    def fatal(self) -> list[WireEvent]:
        return [event for event in self.watch.drain() if event.fatal]


@contextmanager
def bench(
    act: Act, profile: CounterProfile = BINARY, *, counts: int = 65536, direction: int = 1
) -> Iterator[Bench]:
    with Peer(act, profile.asks.size) as far:
        watch = Watch()
        counter = SerialCounter(settings(profile, counts, direction), watch, far.clock())
        counter.open()
        counter.begin()
        try:
            yield Bench(counter, watch, far)
        finally:
            counter.close()


def settings(
    profile: CounterProfile = BINARY, counts: int = 65536, direction: int = 1
) -> CounterSettings:
    line = CounterLine("/dev/counter", 115200)
    return CounterSettings(line, profile, counts, PERIOD_S, 0.1, 1 if direction > 0 else -1)


@pytest.fixture
def narrow(tmp_path: Path) -> CounterProfile:
    path = tmp_path / "narrow.toml"
    path.write_text(NARROW)
    return load_profile(str(path))


def narrow_answer(count: int) -> bytes:
    data = b"=" + (count % (1 << 16)).to_bytes(2, "big")
    return data + bytes([data[0] ^ data[1] ^ data[2]])


@pytest.mark.parametrize("step", [3000, -3000])
def test_counts_run_on_over_the_end_of_the_counter_in_both_directions(
    narrow: CounterProfile, step: int
) -> None:
    with bench(lambda n, _: [narrow_answer(1000 + n * step)], narrow) as it:
        counts = it.play(range(60))
    assert [counts[slot] for slot in range(60)] == [1000 + (n + 1) * step for n in range(60)]
    assert max(abs(c or 0) for c in counts.values()) > 2 * (1 << 16), "twice over at the least"


def test_the_direction_turns_the_angle_and_leaves_the_counts() -> None:
    with bench(lambda n, q: [binary_answer(q[1], n)], direction=-1, counts=1000) as it:
        assert it.play(range(2)) == {0: 1, 1: 2}
        assert it.counter.rad_per_count == pytest.approx(-6.283185307 / 1000)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda good: [],
        lambda good: [good[:-1]],
        lambda good: [good[:6] + bytes([good[6] ^ 1]) + good[7:]],
        lambda good: [bytes([good[0] ^ 0x80]) + good[1:]],
    ],
    ids=["lost", "cut off", "wrong check sum", "wrong head"],
)
def test_a_lost_or_wrong_answer_costs_its_own_slot_and_is_told(wrong) -> None:  # type: ignore[no-untyped-def]
    def act(n: int, request: bytes) -> list[bytes]:
        good = binary_answer(request[1], 100 * n)
        return wrong(good) if n in (4, 9) else [good]  # type: ignore[no-any-return]

    with bench(act) as it:
        counts = it.play(range(15))
        told = [event.text for event in it.watch.drain() if event.kind == "load sample lost"]
    assert counts == {k: None if k + 1 in (4, 9) else 100 * (k + 1) for k in range(15)}
    assert [text.split(" has")[0].split()[-1] for text in told] == ["3", "8"]


def test_noise_before_an_answer_does_not_cost_it() -> None:
    noise = b"\x5a\xff\x00\x5a"
    with bench(lambda n, q: [noise[: n % 5] + binary_answer(q[1], n)]) as it:
        assert it.play(range(12)) == {k: k + 1 for k in range(12)}


@pytest.mark.parametrize("numbered", [True, False])
def test_an_answer_that_comes_with_the_next_one_is_never_taken_for_it(
    narrow: CounterProfile, numbered: bool
) -> None:
    """Positions tell which request an answer belongs to; a stale one would show as a wrong one."""
    held: list[bytes] = []

    def act(n: int, request: bytes) -> list[bytes]:
        answer = binary_answer(request[1], 100 * n) if numbered else narrow_answer(100 * n)
        if n % 6 == 4:
            held.append(answer)
            return []
        out = [*held, answer]
        held.clear()
        return out

    with bench(act, BINARY if numbered else narrow) as it:
        truth: list[int] = []
        for slot in range(40):
            asked = len(it.peer.requests)
            counts = it.play(range(slot, slot + 1))
            if len(it.peer.requests) > asked and counts.get(slot) is not None:
                truth.append(slot)
                assert counts[slot] == 100 * asked, "the slot's own, or none"
        assert len(truth) > 20
        assert it.counter.troubles["no answer"] >= 3
        if not numbered:
            shown, lost = it.counter.troubles["asked for show"], it.counter.troubles["no answer"]
            assert shown in (lost - 1, lost), "the last one may have been lost in the last slot"


def test_a_counter_that_falls_silent_is_fatal_in_one_sentence() -> None:
    with bench(lambda n, q: [binary_answer(q[1], n)] if n < 5 else []) as it:
        counts = it.play(range(40))
        fatal = it.fatal()
    assert [event.kind for event in fatal] == ["load encoder silent"]
    assert "no good answer for 0.2" in fatal[0].text
    assert "x no answer" in fatal[0].text
    assert not any(counts[slot] for slot in range(4, 40) if slot in counts)


def test_a_status_that_says_so_is_no_count_and_unplugging_ends_it() -> None:
    with bench(lambda n, q: [binary_answer(q[1], n, status=0x80 if n == 3 else 1)]) as it:
        assert it.play(range(5)) == {0: 1, 1: 2, 2: None, 3: 4, 4: 5}
        assert it.counter.troubles["status 0x80, signals or supply of the encoder"] == 1
        it.peer.unplug()
        with pytest.raises(WireError, match=r"the counter on .* is gone: .*Check the adapter"):
            it.play(range(5, 8))


@pytest.mark.parametrize(("lost", "fatal"), [(0, []), (500, ["index disagrees"])])
def test_index_pulses_a_whole_turn_apart_are_believed_and_others_are_not(
    lost: int, fatal: list[str]
) -> None:
    """1000 counts in 10 requests, an index every 4096 counts; `lost` counts go after the first."""

    def act(n: int, request: bytes) -> list[bytes]:
        true = 100 * n
        number = (true + 4000) // 4096  # the index lies at 96, 4192, ...
        off = lost if number > 1 else 0
        return [
            binary_answer(request[1], true - off, number=number, index=4096 * number - 4000 - off)
        ]

    with bench(act, counts=4096) as it:
        it.play(range(100))
        events = it.watch.drain()
    assert [event.kind for event in events if event.fatal] == fatal
    first = next(event for event in events if event.kind == "index")
    assert "at 96 counts" in first.text


def test_a_counter_that_never_answers_is_refused_with_what_to_check() -> None:
    with (
        pytest.raises(WireError, match=r"does not answer: asked 20 times at 115200 Bd 8N1"),
        bench(lambda n, q: [b"hello, I am a modem"]),
    ):
        raise AssertionError("it must not open")


@dataclass
class FakeAxis:
    """An axis that answers at once, or `late` slots later."""

    late: int = 0
    refuse: bool = False
    log: list[str] = field(default_factory=list)
    asked: list[int] = field(default_factory=list)
    may_be_powered: bool = False

    def __enter__(self) -> Self:
        if self.refuse:
            raise DriveError("no")
        self.log.append("enter")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.log.append("exit")

    def command(self, velocity_rad_s: float, slot: int) -> int:
        self.asked.append(slot)
        return slot * PERIOD_NS

    def samples(self, until_ns: int) -> Sequence[Sample]:
        ready = self.asked[: max(len(self.asked) - self.late, 0)]
        self.asked = self.asked[len(ready) :]
        return [
            Sample(
                slot,
                slot * PERIOD_NS,
                motor_position_counts=10 * slot,
                motor_position_rad=0.01 * slot,
            )
            for slot in ready
        ]

    def finish(self) -> Sequence[Sample]:
        self.late = 0
        return self.samples(0)

    def events(self) -> Sequence[WireEvent]:
        return []


@pytest.mark.parametrize("late", [0, 3])
def test_both_parts_of_a_slot_are_joined_however_late_the_drive_is(late: int) -> None:
    inner = FakeAxis(late)
    with Peer(lambda n, q: [] if n in (6, 20) else [binary_answer(q[1], 100 * n)], 2) as far:
        axis = AxisWithCounter(inner, settings(), far.clock())
        samples: list[Sample] = []
        with axis:
            for slot in range(20):
                end_ns = far.now_ns + PERIOD_NS
                axis.command(0.0, slot)
                samples += axis.samples(end_ns - 500_000)
                far.now_ns = max(far.now_ns, end_ns)
            assert len(samples) <= 20 - late
            samples += axis.finish()
            assert inner.log == ["enter"]
        assert inner.log == ["enter", "exit"]
    assert [it.slot for it in samples] == list(range(20))
    for it in samples:
        assert it.motor_position_counts == 10 * it.slot
        lost = it.slot in (5, 19)
        assert it.load_angle_counts == (None if lost else 100 * (it.slot + 1))
        assert (it.load_sampled_ns is None) == (it.load_angle_rad is None) == lost


def test_a_drive_that_cannot_be_enabled_leaves_the_counters_line_free() -> None:
    with Peer(lambda n, q: [binary_answer(q[1], n)], 2) as far:
        axis = AxisWithCounter(FakeAxis(refuse=True), settings(), far.clock())
        with pytest.raises(DriveError), axis:
            raise AssertionError("it must not enter")
        assert far.is_let_go


def test_a_load_that_stands_while_the_motor_turns_is_fatal() -> None:
    with (
        Peer(lambda n, q: [binary_answer(q[1], 7)], 2) as far,
        AxisWithCounter(FakeAxis(), settings(), far.clock()) as axis,
    ):
        for slot in range(40):
            axis.command(0.0, slot)
            axis.samples(far.now_ns + PERIOD_NS)
        fatal = [event.kind for event in axis.events() if event.fatal]
    assert fatal == ["load does not move", "encoders disagree"]


def test_an_answer_that_comes_too_late_is_lost_though_it_is_right() -> None:
    """When its count was taken nobody knows: the request may have been held up on its way."""
    far: list[Peer] = []

    def act(n: int, request: bytes) -> list[bytes]:
        if n == 4:
            far[0].now_ns += 5_000_000
        return [binary_answer(request[1], n)]

    with bench(act) as it:
        far.append(it.peer)
        assert it.play(range(8)) == {k: None if k == 3 else k + 1 for k in range(8)}
        assert it.counter.troubles == {"late": 1}
