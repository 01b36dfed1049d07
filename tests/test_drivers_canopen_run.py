"""Running, watching, and leaving: on a bus and a clock that a test commands."""

import itertools
import logging
import os
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import can
import pytest

from drivers.axis import Sample, WireEvent
from drivers.canopen.line import Line, open_bus
from drivers.canopen.master import CanopenAxis
from drivers.canopen.profile import Stopping, generic
from drivers.errors import SettingsError, WireError
from tests.contract_axis import check_axis
from tests.fake_canopen import FakeRig
from tests.modbus_peer import pty

PERIOD_S = 0.008
PERIOD_NS = 8_000_000


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeRig:
    monkeypatch.setattr(logging.getLogger("canopen"), "disabled", True)
    return FakeRig(tmp_path, monkeypatch)


class Run:
    """An entered axis played at velocity 1, and what came of it; `at` acts before a slot."""

    def __init__(self, rig: FakeRig, axis: CanopenAxis) -> None:
        self.rig, self.axis = rig, axis
        self.samples: list[Sample] = []
        self.events: list[WireEvent] = list(axis.events())
        self.slot = 0
        self.at: dict[int, Callable[[], None]] = {}

    def play(self, slots: int) -> None:
        clock = self.rig.world.clock
        for slot in range(self.slot, self.slot + slots):
            self.at.get(slot, lambda: None)()
            self.samples += self.axis.samples(clock.now_ns())
            end_ns = clock.now_ns() + PERIOD_NS
            self.axis.command(1.0, slot)
            self.samples += self.axis.samples(end_ns)
            clock.sleep_until(end_ns)
            self.events += self.axis.events()
        self.slot += slots

    def kinds(self, *, fatal: bool) -> list[str]:
        return [event.kind for event in self.events if event.fatal == fatal]


def test_the_master_keeps_the_promise_of_every_axis(rig: FakeRig) -> None:
    check_axis(rig.axis, lambda: rig.drive.enabled, period_s=PERIOD_S, clock=rig.world.clock)


def test_the_master_keeps_it_counting_the_other_way(rig: FakeRig) -> None:
    check_axis(
        lambda: rig.axis(direction=-1),
        lambda: rig.drive.enabled,
        period_s=PERIOD_S,
        clock=rig.world.clock,
    )


def test_a_sample_is_taken_before_its_command_acts(rig: FakeRig) -> None:
    with rig.axis() as axis:
        run = Run(rig, axis)
        run.play(5)
    velocities = [s.motor_velocity_rad_s for s in run.samples]
    assert velocities[0] == 0.0
    assert velocities[1:] == pytest.approx([1.0] * 4, abs=1e-4)
    times = [s.device_time_us or 0 for s in run.samples]
    assert all(abs(t * 1000 - s.asked_ns) < 10_000 for t, s in zip(times, run.samples, strict=True))
    assert run.events == []


def test_each_command_goes_out_before_its_sync_and_leaving_begins_with_quick_stop(
    rig: FakeRig,
) -> None:
    with rig.axis() as axis:
        rig.world.sent.clear()
        Run(rig, axis).play(5)
    cycle = [(cob_id, data) for cob_id, data in rig.world.sent if cob_id in (0x201, 0x080)]
    assert [cob_id for cob_id, _ in cycle] == [0x201, 0x080] * (len(cycle) // 2)
    words = [data[0] for cob_id, data in cycle if cob_id == 0x201]
    assert words[:6] == [0x0F] * 5 + [0x02]
    assert rig.nothing_enabled()


@pytest.mark.parametrize(("option", "least_s", "most_s"), [(2, 0.5, 0.6), (6, 0.2, 0.3)])
def test_a_drive_that_stays_in_quick_stop_is_powered_off(
    rig: FakeRig, option: int, least_s: float, most_s: float
) -> None:
    """After the timeout; where it stays by its own option, once it has stood for a while."""
    rig.drive.stays_in_quick_stop = True
    stopping = Stopping(quick_stop_option=option)
    profile = generic().model_copy(update={"stopping": stopping})
    with rig.axis(stop_timeout_s=0.5, profile=profile) as axis:
        Run(rig, axis).play(3)
        begun_ns = rig.world.now_ns
    assert least_s * 1e9 <= rig.world.now_ns - begun_ns < most_s * 1e9
    assert rig.nothing_enabled()


def test_a_drive_that_stays_in_quick_stop_turning_is_powered_off_after_the_timeout(
    rig: FakeRig,
) -> None:
    rig.drive.stays_in_quick_stop = rig.drive.turns_in_quick_stop = True
    with rig.axis(stop_timeout_s=0.5) as axis:
        Run(rig, axis).play(3)
        begun_ns = rig.world.now_ns
    assert 0.5e9 <= rig.world.now_ns - begun_ns < 0.6e9
    assert rig.nothing_enabled()


def test_a_statusword_that_says_off_is_not_believed_while_the_shaft_turns(rig: FakeRig) -> None:
    rig.drive.coasts = True
    with pytest.raises(WireError, match=r"off, but its position says.*turns at (1|0\.99\d*) rad/s"):
        session(rig)
    words = [data[0] for cob_id, data in rig.world.sent if cob_id == 0x201]
    assert words.count(0x02) > 100, "quick stop, for as long as it turns"
    assert rig.world.closed == 1


def test_the_load_angle_runs_on_over_the_end_of_the_encoder(rig: FakeRig) -> None:
    with rig.axis() as axis:
        run = Run(rig, axis)
        run.play(30)
    counts = [s.load_angle_counts or 0 for s in run.samples]
    assert {b - a for a, b in pairwise(counts)} == {rig.encoder.step}
    assert rig.encoder[0x6004, 0] < counts[-1], "the encoder itself has wrapped"


def test_the_heartbeat_of_the_master_comes_with_the_commands(rig: FakeRig) -> None:
    with rig.axis(heartbeat_s=0.05) as axis:
        rig.world.sent.clear()
        rig.world.clock.sleep_s(0.25)
        assert not rig.world.sent, "no thread of the master's keeps beating beside its loop"
        Run(rig, axis).play(50)  # 0.4 s
        beats = [data for cob_id, data in rig.world.sent if cob_id == 0x77F]
    assert beats == [b"\x05"] * len(beats)
    assert 7 <= len(beats) <= 9


@pytest.mark.parametrize("velocity_rad_s", [1e9, -1e9, float("nan"), float("inf")])
def test_a_velocity_that_the_wire_cannot_say(rig: FakeRig, velocity_rad_s: float) -> None:
    with (
        pytest.raises(SettingsError, match=r"does not fit.*Lower the amplitude"),
        rig.axis() as axis,
    ):
        axis.command(velocity_rad_s, 0)
    assert rig.nothing_enabled()


def lose(rig: FakeRig, cob_id: int) -> Callable[[], None]:
    """Lose the next frame of this COB-ID."""

    def drops(passing: int) -> bool:
        if passing == cob_id:
            rig.world.drops = lambda _: False
            return True
        return False

    def arm() -> None:
        rig.world.drops = drops

    return arm


@pytest.mark.parametrize("cob_id", [0x181, 0x281, 0x282])
def test_a_lost_answer_leaves_a_gap_in_its_own_slot_alone(rig: FakeRig, cob_id: int) -> None:
    with rig.axis() as axis:
        run = Run(rig, axis)
        run.at = {5: lose(rig, cob_id)}
        run.play(60)
    assert [s.slot for s in run.samples] == list(range(60))
    gaps = {
        0x181: [s.slot for s in run.samples if s.motor_position_rad is None],
        0x281: [s.slot for s in run.samples if s.motor_velocity_rad_s is None],
        0x282: [s.slot for s in run.samples if s.load_angle_rad is None],
    }
    assert gaps == {0x181: [], 0x281: [], 0x282: []} | {cob_id: [5]}
    assert [(e.kind, e.fatal) for e in run.events] == [("answer lost", False)]
    assert "slot 5" in run.events[0].text
    times = [s.device_time_us for s in run.samples if s.device_time_us]
    assert all(7990 <= b - a <= 16010 for a, b in pairwise(times))


def test_an_answer_that_comes_twice_is_told_and_dropped(rig: FakeRig) -> None:
    with rig.axis() as axis:
        run = Run(rig, axis)
        run.at = {3: lambda: rig.world.deliver(0x181, bytes.fromhex("3712 11223344 0000"))}
        run.play(10)
    assert [(e.kind, e.fatal) for e in run.events] == [("duplicate answer", False)]
    assert [s.slot for s in run.samples] == list(range(10))
    assert all(abs(s.motor_position_counts or 0) < 65536 for s in run.samples)


def test_answers_that_go_on_coming_twice_are_told_a_few_times_and_counted(rig: FakeRig) -> None:
    """The session takes so many words only: the pipe to it must never be full."""
    again = bytes.fromhex("3712 11223344 0000")
    with rig.axis() as axis:
        run = Run(rig, axis)
        run.at = {slot: lambda: rig.world.deliver(0x181, again) for slot in range(3, 43)}
        run.play(60)
        axis.finish()
        (total,) = axis.events()
    assert [event.kind for event in run.events] == 8 * ["duplicate answer"]
    assert run.events[-1].text.endswith("Further ones are counted, not told.")
    assert (total.kind, total.fatal) == ("duplicate answer", False)
    assert total.text == "drive 1: 40 in all, of which the first 8 were told."


def test_strangers_are_told_a_few_times_and_harm_nobody(rig: FakeRig) -> None:
    def chatter() -> None:
        for cob_id in range(0x300, 0x340):
            rig.world.deliver(cob_id, b"hello")

    with rig.axis() as axis:
        run = Run(rig, axis)
        run.at = {2: chatter, 3: chatter}
        run.play(6)
    assert set(run.kinds(fatal=False)) == {"foreign frame"}
    assert len(run.events) < 10
    assert len(run.samples) == 6


def test_an_emergency_is_fatal_and_in_words(rig: FakeRig) -> None:
    with rig.axis() as axis:
        run = Run(rig, axis)
        run.at = {4: lambda: rig.drive.trip(0x3220)}
        run.play(6)
    assert run.kinds(fatal=True) == ["emergency", "drive not enabled"]
    assert "0x3220 (DC link under-voltage)" in run.events[0].text
    assert "switch on the DC link" in run.events[0].text
    assert "fault (statusword 0x" in run.events[1].text
    assert rig.nothing_enabled()


def test_the_end_of_an_emergency_is_not_fatal(rig: FakeRig) -> None:
    with rig.axis() as axis:
        run = Run(rig, axis)
        run.at = {1: lambda: rig.encoder.emergency(0x0000)}
        run.play(3)
    assert run.kinds(fatal=False) == ["emergency over"]
    assert run.kinds(fatal=True) == []


def test_a_drive_that_restarts_is_fatal_and_leaving_sees_that_it_is_off(rig: FakeRig) -> None:
    with rig.axis() as axis:
        run = Run(rig, axis)
        run.at = {4: rig.drive.restart}
        run.play(6)
        begun_ns = rig.world.now_ns
    assert rig.world.now_ns - begun_ns < 0.1e9, "no waiting for answers that cannot come"
    assert "node restarted" in run.kinds(fatal=True)
    assert rig.nothing_enabled()


def test_an_encoder_that_somebody_stops_is_fatal(rig: FakeRig) -> None:
    with rig.axis() as axis:
        run = Run(rig, axis)
        run.at = {4: lambda: rig.encoder.take(0, bytes((0x02, 2)))}
        run.play(60)
    assert run.kinds(fatal=True) == ["node not operational", "node silent"]
    assert all("encoder 2" in event.text for event in run.events)
    assert [s.slot for s in run.samples if s.load_angle_rad is None][:2] == [4, 5]


def test_a_drive_that_no_longer_follows_is_fatal(rig: FakeRig) -> None:
    def let_go() -> None:
        rig.drive[0x6041, 0] &= ~0x1000
        rig.drive.follows = False

    with rig.axis() as axis:
        run = Run(rig, axis)
        run.at = {4: let_go}
        run.play(6)
    assert run.kinds(fatal=True) == ["velocity not followed"]


def test_a_pdo_of_another_length_is_fatal(rig: FakeRig) -> None:
    with rig.axis() as axis:
        run = Run(rig, axis)
        run.at = {4: lambda: rig.world.deliver(0x181, b"\x37\x12")}
        run.play(6)
    assert run.kinds(fatal=True) == ["malformed answer"]


def unplug(rig: FakeRig) -> Callable[[], None]:
    return lambda: rig.world.nodes.remove(rig.drive)


def test_a_drive_that_falls_silent_is_told_and_its_unseen_stop_too(rig: FakeRig) -> None:
    runs = []

    def session() -> None:
        with rig.axis() as axis:
            runs.append(run := Run(rig, axis))
            run.at = {4: unplug(rig)}
            run.play(60)

    words = r"did not confirm its stop; last state: operation enabled.*by itself 0\.3 s"
    with pytest.raises(WireError, match=words):
        session()
    assert set(runs[0].kinds(fatal=True)) == {"node silent", "heartbeat missing"}
    assert rig.world.closed == 1


def test_an_unseen_stop_never_hides_what_was_raised(rig: FakeRig) -> None:
    def session() -> None:
        with rig.axis(without=(0x1016,), without_watchdog=True) as axis:
            unplug(rig)()
            axis.command(1.0, 0)
            raise KeyError("mine")

    with pytest.raises(KeyError, match="mine") as caught:
        session()
    (note,) = caught.value.__notes__
    assert "did not confirm its stop" in note
    assert "does not watch this master's heartbeat (no 0x1016) and may still turn" in note
    assert "emergency stop" in note


def test_a_drive_that_will_not_stop_is_said_after_the_timeout(rig: FakeRig) -> None:
    begun_ns = []

    def session() -> None:
        with rig.axis() as axis:
            Run(rig, axis).play(3)
            rig.drive._transition = lambda controlword: None
            begun_ns.append(rig.world.now_ns)

    with pytest.raises(WireError, match="did not confirm its stop"):
        session()
    assert rig.world.now_ns - begun_ns[0] >= 2e9
    words = [data[0] for cob_id, data in rig.world.sent if cob_id == 0x201]
    assert words[-1] == 0x00
    assert 0x02 in words


def test_a_bus_that_dies_mid_run_is_a_wire_error_with_what_is_left_undone(rig: FakeRig) -> None:
    def session() -> None:
        with rig.axis() as axis:
            run = Run(rig, axis)
            run.at = {4: lambda: setattr(rig.world, "dead", True)}
            run.play(6)

    with pytest.raises(WireError, match=r"is gone.*Check server") as caught:
        session()
    assert "did not confirm its stop" in caught.value.__notes__[0]
    assert rig.world.closed == 1


def test_a_bus_that_is_dead_when_leaving_raises_if_nothing_else_does(rig: FakeRig) -> None:
    with pytest.raises(WireError, match=r"did not confirm its stop.*Broken pipe"), rig.axis():
        rig.world.dead = True
    assert rig.world.closed == 1


@pytest.mark.parametrize("raised", [ValueError("invalid literal"), IndexError("string index")])
def test_a_garbled_line_of_text_is_passed_over(
    rig: FakeRig, monkeypatch: pytest.MonkeyPatch, raised: Exception
) -> None:
    receive, count = rig.world.receive, itertools.count()

    def garbled(timeout_s: float) -> can.Message | None:
        if next(count) % 5 == 0:
            raise raised
        return receive(timeout_s)

    monkeypatch.setattr(rig.world, "receive", garbled)
    with rig.axis() as axis:
        run = Run(rig, axis)
        run.play(6)
    assert [sample.slot for sample in run.samples] == list(range(6))
    assert all(sample.motor_position_counts is not None for sample in run.samples)


@pytest.mark.parametrize("garbled", [b"t18Z2AABB\r", b"t1\r", b"t1812AA\xffB\r"])
def test_a_damaged_byte_on_slcans_serial_line_costs_one_frame(garbled: bytes) -> None:
    with pty() as (near, device):
        options = {"interface": "slcan", "channel": device, "sleep_after_open": 0.0}
        line = Line(open_bus(options))
        os.write(near, garbled + b"t1812AABB\r")
        frames = [line.read(0.1) for _ in range(2)]
        line.close()
    (frame,) = [it for it in frames if it is not None]
    assert (frame.arbitration_id, bytes(frame.data)) == (0x181, b"\xaa\xbb")


def test_a_line_that_is_garbled_for_good_ends_in_words(
    rig: FakeRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def garbled(timeout_s: float) -> can.Message | None:
        rig.world.clock.sleep_s(timeout_s)
        raise ValueError("invalid literal")

    monkeypatch.setattr(rig.world, "receive", garbled)
    with pytest.raises(WireError, match="does not answer"), rig.axis():
        pass


def session(rig: FakeRig) -> None:
    """Enter, play, leave; asked for as a whole."""
    with rig.axis() as axis:
        Run(rig, axis).play(3)


@pytest.mark.parametrize(
    "raised", [KeyboardInterrupt, pytest.param(WireError, marks=pytest.mark.long)]
)
def test_wherever_it_is_interrupted_the_drive_is_off_and_the_bus_closed(
    rig: FakeRig, monkeypatch: pytest.MonkeyPatch, raised: type[BaseException]
) -> None:
    """Raise at each single frame that a whole session sends, one after the other."""
    take = rig.world.take
    session(rig)
    rig.world.sent.clear()
    session(rig)
    frames = len(rig.world.sent)
    assert frames > 100
    for fatal_frame in range(frames):
        rig.world.sent.clear()
        rig.world.closed = 0

        def failing(cob_id: int, data: bytes, fatal_frame: int = fatal_frame) -> None:
            if len(rig.world.sent) == fatal_frame:
                rig.world.sent.append((cob_id, data))
                raise raised("now")
            take(cob_id, data)

        monkeypatch.setattr(rig.world, "take", failing)
        with suppress(raised):  # an interrupted last word to a stopped drive raises nothing
            session(rig)
        assert not rig.drive.enabled, fatal_frame
        assert rig.world.closed == 1, fatal_frame
        assert len(rig.world.sent) > fatal_frame
