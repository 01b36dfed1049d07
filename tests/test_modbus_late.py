"""No answer is ever taken for another slot's, whatever the drive does with its answers.

The peer answers the target velocity's digits as the motor's position, and slot k commands k + 1
digits: a sample of slot k that holds anything but k + 1 is stale.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import pytest

from drivers.axis import Sample, WireEvent
from drivers.clock import SYSTEM_CLOCK
from drivers.errors import DriveError, WireError
from drivers.modbus.library import load_profile
from drivers.modbus.lines import RtuLine, TcpLine
from drivers.modbus.master import ModbusAxis
from drivers.modbus.settings import ModbusDriveSettings, ModbusSettings
from servo_bench.rig import load_rig
from tests.modbus_peer import UNIT, Act, HangUp, Peer, pty, rtu_frame, running, tcp_frame
from tests.virtual_line import install_lines
from tests.virtual_modbus import VirtualModbus

COUNTS = 65536
PERIOD_S = 0.008
DIGIT_RAD_S = math.tau / COUNTS

MakeAxis = Callable[..., AbstractContextManager[tuple[Peer, ModbusAxis]]]


def settings(line: TcpLine | RtuLine, answer_timeout_s: float) -> ModbusSettings:
    drive = ModbusDriveSettings(UNIT, load_profile("generic"), COUNTS)
    return ModbusSettings(line, drive, PERIOD_S, answer_timeout_s)


@contextmanager
def tcp_axis(act: Act, answer_timeout_s: float = 0.3) -> Iterator[tuple[Peer, ModbusAxis]]:
    with running(Peer(act)) as peer:
        yield peer, ModbusAxis(settings(TcpLine(*peer.address), answer_timeout_s))


@contextmanager
def rtu_axis(act: Act, answer_timeout_s: float = 0.3) -> Iterator[tuple[Peer, ModbusAxis]]:
    with pty() as (near, device), running(Peer(act, near=near)) as peer:
        yield peer, ModbusAxis(settings(RtuLine(device, 460800, "N", 2), answer_timeout_s))


BOTH = pytest.mark.parametrize("make_axis", [tcp_axis, rtu_axis])


def play(axis: ModbusAxis, slots: int) -> tuple[list[Sample], list[WireEvent]]:
    """Slot k commands k + 1 digits."""
    samples: list[Sample] = []
    begin_ns = SYSTEM_CLOCK.now_ns()
    for slot in range(slots):
        SYSTEM_CLOCK.sleep_until(begin_ns + round(slot * PERIOD_S * 1e9))
        axis.command((slot + 1) * DIGIT_RAD_S, slot)
        samples += axis.samples(begin_ns + round((slot + 0.9) * PERIOD_S * 1e9))
    while len(samples) < slots:
        samples += axis.samples(SYSTEM_CLOCK.now_ns() + 10_000_000)
    return samples, list(axis.events())


def assert_nothing_stale(samples: list[Sample], slots: int) -> None:
    assert [sample.slot for sample in samples] == list(range(slots))
    assert len({sample.asked_ns for sample in samples}) == slots
    for sample in samples:
        assert sample.motor_position_counts in (None, sample.slot + 1), sample


def answered(samples: list[Sample]) -> int:
    return sum(sample.motor_position_counts is not None for sample in samples)


def refusal(frame: bytes, code: int) -> bytes:
    """An exception reply to a request, on the line that it came from."""
    pdu = bytes([23 | 0x80, code])
    if frame[0] == UNIT and frame[1] == 23:
        return rtu_frame(pdu)
    return tcp_frame(pdu, int.from_bytes(frame[:2], "big"))


def good(_: int, __: bytes, answer: bytes) -> list[bytes]:
    return [answer]


@BOTH
def test_an_undisturbed_run(make_axis: MakeAxis) -> None:
    with make_axis(good) as (peer, axis):
        with axis:
            samples, events = play(axis, 30)
        assert_nothing_stale(samples, 30)
        assert answered(samples) >= 15
        assert [event.text for event in events if event.fatal] == []
        assert peer.registers.words[0x0010] == 0, "the watchdog is off again"
        assert peer.registers.words[0x0100] == 0, "and the power stage"


@BOTH
@pytest.mark.parametrize("which", [{3}, {2, 5}, {4, 5, 6}])
def test_an_answer_that_comes_with_the_next_request_is_never_taken_for_its_answer(
    make_axis: MakeAxis, which: set[int]
) -> None:
    """Later than the drive's longest response time: the old answer first, then the right one."""
    held: list[bytes] = []

    def act(number: int, _: bytes, answer: bytes) -> list[bytes]:
        if number in which:
            held.append(answer)
            return []
        late = [held.pop(0)] if held else []
        return [*late, answer]

    with make_axis(act) as (_, axis), axis:
        samples, events = play(axis, 40)
    assert_nothing_stale(samples, 40)
    assert len([event for event in events if event.kind == "answer lost"]) >= len(which)
    assert answered(samples[-8:]), "it goes on after it"


@BOTH
def test_an_old_answer_that_comes_instead_of_the_next_one(make_axis: MakeAxis) -> None:
    """The worst case on a serial line: the frame of before, and then nothing."""
    held: list[bytes] = []

    def act(number: int, _: bytes, answer: bytes) -> list[bytes]:
        held.append(answer)
        return [] if number == 3 else [held[3]] if number == 4 else [answer]

    with make_axis(act) as (_, axis), axis:
        samples, _ = play(axis, 30)
    assert_nothing_stale(samples, 30)


@BOTH
def test_every_answer_twice(make_axis: MakeAxis) -> None:
    with make_axis(lambda _number, _frame, answer: [answer, answer]) as (_, axis), axis:
        samples, _ = play(axis, 30)
    assert_nothing_stale(samples, 30)
    assert answered(samples)


@BOTH
def test_exception_replies_leave_holes(make_axis: MakeAxis) -> None:
    def act(number: int, frame: bytes, answer: bytes) -> list[bytes]:
        return [refusal(frame, 4)] if number in (5, 6) else [answer]

    with make_axis(act) as (_, axis), axis:
        samples, events = play(axis, 30)
    assert_nothing_stale(samples, 30)
    told = [event.text for event in events if event.kind == "exception reply"]
    assert len(told) == 2
    assert all("exception 0x04 to function 23 (device failure" in text for text in told)


@BOTH
def test_a_drive_that_only_refuses_ends_the_run(make_axis: MakeAxis) -> None:
    def act(number: int, frame: bytes, answer: bytes) -> list[bytes]:
        return [refusal(frame, 4)] if number > 5 else [answer]

    with make_axis(act, answer_timeout_s=0.05) as (_, axis), axis:
        _, events = play(axis, 60)
    (fatal,) = [event for event in events if event.fatal]
    assert fatal.kind == "drive silent"
    assert "exception 0x04" in fatal.text


@BOTH
def test_a_drive_that_falls_silent_ends_the_run(make_axis: MakeAxis) -> None:
    def act(number: int, _: bytes, answer: bytes) -> list[bytes]:
        return [answer] if number < 5 else []

    with make_axis(act) as (peer, axis):
        with axis:
            samples, events = play(axis, 60)
        assert_nothing_stale(samples, 60)
        assert [event.kind for event in events if event.fatal] == ["drive silent"]
        assert peer.registers.words[0x0100] == 0, "it was stopped all the same"


def test_wrong_check_sums_and_other_units_leave_holes() -> None:
    def act(number: int, _: bytes, answer: bytes) -> list[bytes]:
        if number == 7:
            return [rtu_frame(answer[1:-2], unit=9)]
        return [answer[:-1] + bytes([answer[-1] ^ 1])] if number == 4 else [answer]

    with rtu_axis(act) as (_, axis), axis:
        samples, events = play(axis, 40)
    assert_nothing_stale(samples, 40)
    assert len([event for event in events if event.kind == "answer lost"]) >= 2
    assert answered(samples[-8:])


@BOTH
def test_a_drive_that_drops_out_of_enabled_ends_the_run(make_axis: MakeAxis) -> None:
    def act(number: int, _: bytes, answer: bytes) -> list[bytes]:
        if number == 5:
            peer.registers.states[0x0F] = 0x0218
        return [answer]

    with make_axis(act) as (peer, axis), axis:
        _, events = play(axis, 20)
    (fatal,) = [event for event in events if event.fatal]
    assert fatal.kind == "drive not enabled"
    assert "statusword 0x0218): it is in fault" in fatal.text


def test_a_connection_that_breaks_is_opened_once_more_to_stop_the_drive() -> None:
    def act(number: int, _: bytes, answer: bytes) -> list[bytes]:
        if number == 5:
            raise HangUp
        return [answer]

    with tcp_axis(act) as (peer, axis):
        with pytest.raises(WireError, match="closed the connection") as raised, axis:
            play(axis, 20)
        assert peer.registers.words[0x0100] == 0
        assert not hasattr(raised.value, "__notes__"), "the stop was confirmed"


def test_a_drive_that_is_gone_for_good_says_what_it_will_do_by_itself() -> None:
    def act(number: int, _: bytes, answer: bytes) -> list[bytes]:
        if number == 5:
            raise HangUp(for_good=True)
        return [answer]

    with (
        tcp_axis(act) as (_, axis),
        pytest.raises(WireError, match="closed the connection") as raised,
        axis,
    ):
        play(axis, 20)
    (note,) = raised.value.__notes__
    assert "did not confirm its stop" in note
    assert "quick-stops by itself and goes into fault 0.3 s after its master's last word" in note


@BOTH
def test_a_drive_that_is_enabled_already_is_not_taken_over(make_axis: MakeAxis) -> None:
    with make_axis(good) as (peer, axis):
        peer.registers.words |= {0x0100: 0x0F, 0x0200: 0x237}
        with pytest.raises(DriveError, match="is enabled already"), axis:
            pytest.fail("entered")
        assert peer.registers.words[0x0100] == 0x0F, "nor switched off"


def test_a_drive_that_does_not_keep_its_timeout_is_refused() -> None:
    with tcp_axis(good) as (peer, axis):
        peer.registers.read_only = {0x0010}
        with pytest.raises(DriveError, match="did not keep its communication timeout"), axis:
            pytest.fail("entered")
        assert peer.registers.words.get(0x0100, 0) != 0x0F


def test_another_drive_is_refused() -> None:
    with tcp_axis(good) as (peer, axis):
        peer.registers.words[0x0001] = 7
        with pytest.raises(DriveError, match="product is 7, its profile says 402"), axis:
            pytest.fail("entered")


def test_an_axis_that_was_not_entered_says_so() -> None:
    with tcp_axis(good) as (_, axis), pytest.raises(WireError, match="has not been entered"):
        axis.command(0.0, 0)


def test_a_command_of_the_masters_own_is_told_as_no_slot() -> None:
    install_lines()
    world = VirtualModbus("own", load_rig("rigs/modbus-rtu.toml"))
    try:
        with world.axis() as axis:
            for slot in (-3, -2, -1):  # at once: the line carries the first only
                axis.command(0.0, slot)
            told = [event.text for event in axis.events() if event.kind == "slot not sent"]
    finally:
        world.close()
    assert len(told) == 1
    assert "a command of the bench's own was not sent" in told[0]


def test_after_a_loss_that_is_noticed_as_late_as_can_be_another_length_is_asked_for() -> None:
    """Nobody looks at the line while the time-out passes: the next command is what notices it."""
    install_lines()
    world = VirtualModbus("late", load_rig("rigs/modbus-rtu.toml").with_faults("lost at=3"))
    axis = world.axis()
    words: list[int] = []
    try:
        with axis:
            link = axis._link  # type: ignore[attr-defined]
            begin = link.begin

            def spy(request: Any) -> int:
                words.append(request.read_count)
                return int(begin(request))

            link.begin = spy
            for slot in range(3):
                axis.command(1.0, slot)
                axis.samples(world.now_ns + 6_000_000)
                world.pass_until(world.now_ns + 100_000_000)
            link.begin = begin
    finally:
        world.close()
    assert words[0] != words[1] == words[2], "an answer to the lost one would fit"
