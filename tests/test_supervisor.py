"""What the supervisor trips on, and what it leaves to the loop: the judge on a clock of its own."""

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.axis import Sample, WireEvent
from drivers.canopen.profile import Temperature, generic
from drivers.canopen.stopline import CanopenStopLine
from drivers.errors import WireError
from drivers.modbus.stopline import ModbusStopLine
from servo_bench.errors import BenchError, LimitError
from servo_bench.errors import WireError as BenchWireError
from servo_bench.rig import Limits, RigConfig, load_rig
from servo_bench.run.judge import KINDS, Judge
from servo_bench.run.limits import DEVICE_TIME_RANGE_US, Guard, check_missed
from servo_bench.run.rows import read_sample, write_answer
from servo_bench.run.supervisor import STALE_S, check_watched
from servo_bench.run.table import SlotTable, Stage, Trip
from tests.fake_canopen import I16, Entry, FakeRig

PERIOD_S, PERIOD_NS = 0.008, 8_000_000
SLOTS = 1000
ENABLED = 0x1237


@dataclass
class Watched:
    """A run that is played row by row, and looked at once a slot."""

    table: SlotTable
    judge: Judge
    slot: int = 0
    now_ns: int = 1_000_000_000
    motor_rad: float = 0.0

    def play(self, slots: int, velocity_rad_s: float = 0.5, **answer: Any) -> Trip | None:
        """So many good slots, but for what `answer` changes; the first trip."""
        for _ in range(slots):
            self.table.beat_ns = self.now_ns
            self.table.slot = self.slot
            self._write(velocity_rad_s, answer)
            trip = self.look()
            self.slot += 1
            self.now_ns += PERIOD_NS
            self.motor_rad += velocity_rad_s * PERIOD_S
            if trip:
                return trip
        return None

    def _write(self, velocity_rad_s: float, answer: dict[str, Any]) -> None:
        row = self.table.rows[self.slot]
        row["asked_ns"] = self.now_ns
        row["velocity_command_rad_s"] = velocity_rad_s
        sample = Sample(
            self.slot,
            self.now_ns,
            drive_answered_ns=self.now_ns + 100_000,
            encoder_answered_ns=self.now_ns + 150_000,
            statusword=ENABLED,
            motor_position_rad=self.motor_rad,
            motor_position_counts=round(self.motor_rad * 1e4),
            load_angle_rad=self.motor_rad,
            load_angle_counts=round(self.motor_rad * 1e4),
            motor_torque_nm=0.01,
        )
        write_answer(row, replace(sample, **answer))
        self.table.done = self.slot + 1

    def look(self, **seen: Any) -> Trip | None:
        return self.judge.look(self.now_ns, self.table, **{"loop_is_gone": False, **seen})


def watched(rig: RigConfig, stage: Stage = Stage.PLAYING) -> Iterator[Watched]:
    with SlotTable.create(SLOTS) as table:
        table.stage = stage
        table.beat_ns = 1_000_000_000
        yield Watched(table, Judge(rig, PERIOD_S))


@pytest.fixture
def run() -> Iterator[Watched]:
    limits = Limits(
        velocity_rad_s=5.0,
        travel_rad=2.0,
        run_time_s=5.0,
        torque_nm=0.3,
        drive_temperature_c=70.0,
    )
    yield from watched(load_rig("rigs/paper.toml").model_copy(update={"limits": limits}))


def test_a_good_run_is_left_alone(run: Watched) -> None:
    assert run.play(200) is None
    assert run.play(200, -0.5) is None
    run.table.stage = Stage.STOPPING
    run.now_ns += 1_000_000_000
    assert run.look() is None
    run.table.stage = Stage.OVER
    assert run.look(loop_is_gone=True) is None


@pytest.mark.parametrize(
    ("kind", "words", "answer"),
    [
        ("limit", "torque reached -0.31", {"motor_torque_nm": -0.31}),
        ("limit", "travel reached", {"motor_position_rad": 2.5}),
        ("limit", "velocity reached", {"motor_position_rad": 0.7}),
        ("drive", "no longer enabled .statusword 0x0218", {"statusword": 0x0218}),
    ],
)
def test_what_the_loop_should_have_acted_on_trips_when_it_has_not(
    run: Watched, kind: str, words: str, answer: dict[str, Any]
) -> None:
    assert run.play(50) is None
    assert run.play(1, **answer) is None, "the loop has its chance first"
    trip = run.play(20)
    assert trip is not None
    assert trip.kind == kind
    assert pytest.approx(run.judge.grace_s, abs=2 * PERIOD_S) == (run.slot - 51) * PERIOD_S
    with pytest.raises(KINDS[kind], match=words):
        raise KINDS[trip.kind](trip.text)


def test_nothing_trips_when_the_loop_acts_in_time(run: Watched) -> None:
    assert run.play(50) is None
    assert run.play(1, motor_torque_nm=0.5) is None
    run.table.stage = Stage.STOPPING
    for _ in range(100):
        run.now_ns += PERIOD_NS
        assert run.look() is None


def test_an_encoder_that_leaves_the_motors_is_implausible(run: Watched) -> None:
    trip = None
    while trip is None and run.slot < SLOTS - 1:
        trip = run.play(1, load_angle_rad=2 * run.motor_rad, load_angle_counts=run.slot * 100)
    assert trip is not None
    assert trip.kind == "implausible"
    assert "encoders disagree" in trip.text


def test_a_motor_that_does_not_follow_is_implausible(run: Watched) -> None:
    run.play(10)
    still = {"motor_position_rad": run.motor_rad, "load_angle_rad": run.motor_rad}
    counts = {"motor_position_counts": 400, "load_angle_counts": 400}
    trip = run.play(200, **still, **counts)
    assert trip is not None
    assert (trip.kind, "motor does not move" in trip.text) == ("implausible", True)


def test_silence_trips_after_the_axis_should_have_given_up(run: Watched) -> None:
    run.play(20)
    nothing = dict.fromkeys(
        (
            *("drive_answered_ns", "encoder_answered_ns", "statusword", "motor_position_rad"),
            *("motor_position_counts", "load_angle_rad", "load_angle_counts", "motor_torque_nm"),
        )
    )
    trip = run.play(200, **nothing)
    assert trip is not None
    assert trip.kind == "bus silent"


def test_a_hole_that_blind_s_allows_is_no_silence() -> None:
    rig = load_rig("rigs/paper.toml")
    patient = rig.limits.model_copy(update={"blind_s": 1.0})
    for run in watched(rig.model_copy(update={"limits": patient})):
        assert run.play(20) is None
        run.now_ns += 500_000_000
        run.motor_rad += 0.5 * 0.5
        run.table.beat_ns = run.now_ns
        for _ in range(10):
            assert run.look() is None, "the first answer after it is still to come"
            run.now_ns += 1_000_000
        assert run.play(50) is None


def test_a_loop_that_begins_no_slot_trips_at_once(run: Watched) -> None:
    run.play(20)
    run.now_ns = run.table.beat_ns + 199_000_000
    assert run.look() is None
    run.now_ns += 2_000_000
    trip = run.look()
    assert trip is not None
    assert (trip.kind, "blind_s allows 0.2 s" in trip.text) == ("loop hung", True)


@pytest.mark.parametrize("stage", [Stage.ENABLING, Stage.PLAYING, Stage.RESTING, Stage.STOPPING])
def test_a_loop_that_dies_while_power_may_be_on_trips(run: Watched, stage: Stage) -> None:
    run.table.stage = stage
    trip = run.look(loop_is_gone=True)
    assert trip is not None
    assert trip.kind == "loop ended"


def test_a_loop_that_left_without_its_drives_word_trips_when_it_has_said_so(run: Watched) -> None:
    run.table.stage = Stage.UNCONFIRMED
    assert run.look() is None
    trip = run.look(loop_is_gone=True)
    assert trip is not None
    assert trip.kind == "stop unconfirmed"


@pytest.mark.parametrize("stage", [Stage.STARTING, Stage.OVER])
def test_a_loop_that_dies_before_or_after_does_not(run: Watched, stage: Stage) -> None:
    run.table.stage = stage
    assert run.look(loop_is_gone=True) is None


def test_a_stop_that_takes_for_ever_trips(run: Watched) -> None:
    run.table.stage = Stage.STOPPING
    assert run.look() is None
    run.now_ns += 60_000_000_000
    trip = run.look()
    assert trip is not None
    assert trip.kind == "loop hung"


def test_a_loop_that_hangs_while_the_last_answers_are_waited_for_trips(run: Watched) -> None:
    run.play(20)
    run.table.stage = Stage.RESTING
    for _ in range(60):
        run.table.beat_ns = run.now_ns
        assert run.look() is None
        run.now_ns += PERIOD_NS
    run.now_ns += 200_000_000
    trip = run.look()
    assert trip is not None
    assert trip.kind == "loop hung"


def test_enabling_has_a_bound_from_its_beginning_and_set_up_has_none(run: Watched) -> None:
    run.table.stage = Stage.ENABLING
    run.table.beat_ns = 0
    for _ in range(100):
        run.now_ns += 10_000_000_000
        assert run.look() is None, "a slave may be slow, and nothing is powered"
    run.table.beat_ns = run.now_ns
    run.now_ns += 20_000_000_000
    assert run.look() is None, "a drive that does not enable is stopped again"
    run.now_ns += 5_000_000_000
    trip = run.look()
    assert trip is not None
    assert (trip.kind, "enabling" in trip.text) == ("loop hung", True)


def test_an_operator_who_is_not_heard_is_heard_by_the_supervisor(run: Watched) -> None:
    run.play(20)
    run.table.ask_stop()
    trip = run.play(100)
    assert trip is not None
    assert trip.kind == "stop ignored"
    assert (run.slot - 20) * PERIOD_S <= 0.25


def test_words_of_the_wire_trip_and_harmless_ones_do_not(run: Watched) -> None:
    run.play(5)
    assert run.look(heard=[WireEvent(1, "emergency over", "gone", fatal=False)]) is None
    assert run.play(20) is None
    assert run.look(heard=[WireEvent(1, "emergency", "drive 1: 0x2310", fatal=True)]) is None
    trip = run.play(20)
    assert trip == Trip("drive", "drive 1: 0x2310")


def test_a_hot_drive_trips_where_a_limit_is_given(run: Watched) -> None:
    run.play(5)
    assert run.judge.wants_temperature
    run.look(temperature_c=69.0)
    assert run.play(10) is None
    run.look(temperature_c=70.5)
    trip = run.play(10)
    assert trip is not None
    assert "70.5 °C, the limit is 70 °C" in trip.text


@given(
    st.lists(st.sampled_from(["stage", "beat", "gone", "stop", "row"]), max_size=30),
    st.integers(0, 2**32),
)
def test_whatever_the_table_holds_the_judge_answers(steps: list[str], seed: int) -> None:
    draw = np.random.default_rng(seed)
    for run in watched(load_rig("rigs/paper.toml"), Stage.STARTING):
        for step in steps:
            if step == "stage":
                run.table.stage = Stage(draw.integers(len(Stage)))
            elif step == "beat":
                run.table.beat_ns = int(draw.integers(0, 2**62))
            elif step == "stop":
                run.table.ask_stop()
            elif step == "row":
                run.table.rows[run.slot] = np.frombuffer(
                    draw.bytes(run.table.rows.dtype.itemsize), run.table.rows.dtype
                )[0]
                run.slot += 1
                run.table.done = run.slot
            run.now_ns += int(draw.integers(0, 10**9))
            with np.errstate(all="ignore"):
                trip = run.look(loop_is_gone=step == "gone")
            assert trip is None or issubclass(KINDS[trip.kind], BenchError)


def test_the_first_cause_stays_latched_whole_and_readable() -> None:
    with SlotTable.create(4) as table:
        assert table.trip is None
        table.latch(Trip("limit", "70.5 °C " * 200), 5)
        table.latch(Trip("drive", "later"), 6)
        trip = table.trip
    assert trip is not None
    assert trip.kind == "limit"
    assert trip.text.startswith("70.5 °C 70.5 °C")
    assert "later" not in trip.text


@pytest.mark.parametrize("velocity_rad_s", [None, -3.5])
def test_a_row_gives_back_the_sample_that_was_written(velocity_rad_s: float | None) -> None:
    sample = Sample(
        2,
        10**12,
        drive_answered_ns=10**12 + 90_123,
        statusword=0x1237,
        motor_position_counts=-7,
        motor_position_rad=-0.25,
        motor_velocity_rad_s=velocity_rad_s,
    )
    with SlotTable.create(4) as table:
        table.rows[2]["asked_ns"] = 10**12
        write_answer(table.rows[2], sample)
        assert read_sample(table.rows[2]) == sample
        late = replace(sample, asked_ns=10**12 + 4_000_000, motor_sampled_ns=10**12 + 4_450_000)
        write_answer(table.rows[2], late)  # the line was busy when the slot's command was due
        assert read_sample(table.rows[2]).motor_sampled_ns == late.motor_sampled_ns


def test_a_counter_beside_the_drive_is_not_judged_by_the_drives_clock() -> None:
    """The load turns at 250 deg/s all the time; the drive's request of slot 2 waited for 4 ms."""
    load_rad_s = math.radians(250.0)
    limits = Limits(velocity_rad_s=math.radians(400.0), travel_rad=50.0, run_time_s=100.0)
    guard = Guard(limits, 0.010, 0)
    for slot, drive_ms in enumerate((0, 10, 24, 30)):
        sample = Sample(
            slot,
            drive_ms * 1_000_000,
            device_time_us=drive_ms * 1000,
            motor_position_rad=load_rad_s * drive_ms * 1e-3,
            load_angle_rad=load_rad_s * slot * 0.010,
            load_sampled_ns=(slot * 10 + 1) * 1_000_000,
        )
        assert guard.breach(sample) is None
    turned = replace(sample, load_angle_rad=2.0, load_sampled_ns=(4 * 10 + 1) * 1_000_000)
    assert "load's velocity reached" in (guard.breach(turned) or "")


@pytest.mark.parametrize("rate", [10.0, 1.0, 0.5, -1.0])
def test_a_velocity_is_a_breach_whatever_the_devices_clock_says(rate: float) -> None:
    """Its clock may be fast, slow, or run backwards; a slot's answer comes 1 ms after its ask."""
    limits = Limits(velocity_rad_s=1.0, travel_rad=50.0, run_time_s=100.0)
    guard = Guard(limits, 0.010, 0)

    def sample(slot: int, velocity_rad_s: float) -> Sample:
        asked_ns = slot * 10_000_000
        return Sample(
            slot,
            asked_ns,
            drive_answered_ns=asked_ns + 1_000_000,
            device_time_us=round(slot * 10_000 * rate) % DEVICE_TIME_RANGE_US,
            load_angle_rad=velocity_rad_s * slot * 0.010,
        )

    assert guard.breach(sample(0, 1.2)) is None
    assert "load's velocity reached" in (guard.breach(sample(1, 1.2)) or "")


def test_a_sync_of_the_drive_that_is_seen_late_is_no_velocity() -> None:
    """The bench was away for two slots, and their SYNCs and answers were waiting for it."""
    guard = Guard(Limits(velocity_rad_s=1.0, travel_rad=50.0, run_time_s=100.0), 0.010, 0)
    for slot, seen_ms in enumerate((0, 10, 39, 39, 40)):
        sample = Sample(
            slot,
            seen_ms * 1_000_000,
            drive_answered_ns=seen_ms * 1_000_000,
            device_time_us=slot * 10_000,
            motor_position_rad=0.95 * slot * 0.010,
        )
        assert guard.breach(sample) is None


def test_the_loop_stops_when_nobody_watches_it() -> None:
    with SlotTable.create(4) as table:
        check_watched(table, 10**15)  # there never was a supervisor
        table.watch_ns = 10**9
        check_watched(table, 10**9 + round(STALE_S * 1e9))
        with pytest.raises(BenchWireError, match=r"has not looked for 3\.0 s"):
            check_watched(table, 10**9 + round((STALE_S + 1.0) * 1e9))


def test_torque_and_cycles_missed_in_a_row_are_limits_of_the_loop_too() -> None:
    limits = Limits(velocity_rad_s=1, travel_rad=1, run_time_s=1, torque_nm=0.5)
    guard = Guard(limits, PERIOD_S, 0)
    assert guard.breach(Sample(0, 0, motor_torque_nm=0.49)) is None
    assert "torque reached -0.51 N m" in (guard.breach(Sample(1, 1, motor_torque_nm=-0.51)) or "")
    check_missed(25, 100, PERIOD_S, limits)
    check_missed(3, 100, 0.1, limits)  # three periods are always allowed, however long they are
    with pytest.raises(LimitError, match="26 slots in a row were missed before slot 100"):
        check_missed(26, 100, PERIOD_S, limits)


# The stop line on CANopen, on a bus in this thread


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeRig:
    monkeypatch.setattr("drivers.canopen.stopline.SHARED_BUSES", {"fake"})
    return FakeRig(tmp_path, monkeypatch)


def orphan(fake: FakeRig, velocity_rad_s: float = 2.0) -> CanopenStopLine:
    """A drive that turns, its master gone without a word, and who watched it."""
    settings = fake.settings()
    axis = fake.axis(settings)
    line = CanopenStopLine(settings, fake.world.clock)
    assert "connection of its own" in line.open()
    axis.__enter__()
    for slot in range(5):
        axis.command(velocity_rad_s, slot)
    assert fake.drive.enabled
    return line


def test_a_stop_goes_out_by_pdo_first_and_is_confirmed_by_sdo(fake: FakeRig) -> None:
    line = orphan(fake)
    sent = len(fake.world.sent)
    assert line.stop() is None
    assert not fake.drive.enabled
    frames = fake.world.sent[sent:]
    assert frames[0] == (0x201, struct.pack("<Hi", 0x0002, 0))
    assert frames[1] == (0x080, b"")
    assert fake.drive[0x1016, 1] == 0, "nobody is watched any more"
    line.close()


def test_a_stop_that_nobody_confirms_is_said_and_ends_in_nmt_stop(fake: FakeRig) -> None:
    line = orphan(fake)
    fake.drive.mute = True
    problem = line.stop()
    assert problem is not None
    assert "did not confirm its stop" in problem
    assert "stops by itself 0.3 s after its master's last word" in problem
    assert fake.world.sent[-1] == (0x000, bytes((0x02, 1)))


def test_a_bus_that_is_gone_is_said_and_never_raised(fake: FakeRig) -> None:
    line = orphan(fake)
    fake.world.dead = True
    with pytest.raises(WireError):
        line.poll()
    assert "is gone" in (line.stop() or "")
    fake.world.dead = False  # for the axis's own bus, which python-can closes


def test_emergencies_and_restarts_are_heard_beside_the_axis(fake: FakeRig) -> None:
    line = orphan(fake)
    line.poll()
    for _ in range(2):  # a second one is told again: nobody may have been listening before
        fake.world.deliver(0x081, struct.pack("<HB5x", 0x2310, 1))
        fake.world.deliver(0x702, b"\x00")
        kinds = [(event.kind, event.fatal) for event in line.poll()]
        assert kinds == [("emergency", True), ("node restarted", True)]
    line.close()


def test_the_temperature_is_asked_where_the_profile_names_it(fake: FakeRig) -> None:
    fake.drive.objects[0x2031, 0] = Entry(I16, 412, writable=False)
    temperature = Temperature.model_validate({"object": "0x2031", "c_per_digit": 0.1})
    hot = generic().model_copy(update={"temperature": temperature})
    line = CanopenStopLine(fake.settings(profile=hot), fake.world.clock)
    line.open()
    assert line.temperature_c() == pytest.approx(41.2)
    fake.drive.mute = True
    assert line.temperature_c() is None
    line.close()
    assert CanopenStopLine(fake.settings(), fake.world.clock).temperature_c() is None


def test_a_line_with_one_owner_is_not_taken_before_a_trip(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = FakeRig(tmp_path, monkeypatch)
    line = CanopenStopLine(fake.settings(), fake.world.clock)
    assert "fake has one owner" in line.open()
    assert line.poll() == []
    assert fake.world.closed == 0
    rtu = load_rig("rigs/modbus-rtu.toml").modbus_settings(PERIOD_S)
    assert "line of its own; the drive stops by itself within 0.3 s" in ModbusStopLine(rtu).open()


def test_the_second_bench_on_a_bus_is_refused_before_it_sends_anything(fake: FakeRig) -> None:
    for cob_id, words in ((0x080, "SYNC was heard"), (0x77F, "heartbeat of node 127 was heard")):
        fake.world.deliver(cob_id, b"")
        sent = len(fake.world.sent)
        with pytest.raises(WireError, match=f"another master is on this bus .*{words}"):
            fake.axis().__enter__()
        assert len(fake.world.sent) == sent
    assert math.isfinite(fake.world.now_ns)
    with fake.axis():
        assert fake.drive.enabled
