"""The bus loop's player on a clock that jumps: what is played, skipped, recorded, and stopped."""

from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.axis import Sample, WireEvent
from servo_bench.clock import Clock
from servo_bench.errors import LimitError, WireError
from servo_bench.excitation.experiment import Experiment, MSequence, RandomBinary, Schedule
from servo_bench.rig import Limits
from servo_bench.run.busloop import Player
from servo_bench.run.limits import check_schedule
from servo_bench.run.table import UNPLAYED, SlotTable

PERIOD_NS = 8_000_000
WIDE = Limits(velocity_rad_s=100.0, travel_rad=100.0, run_time_s=1000.0)


class JumpingClock(Clock):
    """Wakes at the deadline, or later by what `holes_ns` says for that wake-up."""

    def __init__(self, holes_ns: Sequence[int] = ()) -> None:
        self.time_ns = 0
        self._holes_ns = list(holes_ns)

    def now_ns(self) -> int:
        return self.time_ns

    def sleep_until(self, deadline_ns: int) -> int:
        self.time_ns = max(self.time_ns, deadline_ns)
        if self._holes_ns:
            self.time_ns += self._holes_ns.pop(0)
        return self.time_ns


class IdealAxis:
    """Turns exactly as commanded and answers in the same slot, or `late` slots later."""

    may_be_powered = False

    def __init__(self, clock: JumpingClock, late: int = 0) -> None:
        self.clock, self.late = clock, late
        self.asks: list[tuple[int, int, float]] = []
        self.pending: list[Sample] = []
        self.told: list[WireEvent] = []
        self.angle_rad = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...

    def command(self, velocity_rad_s: float, slot: int) -> int:
        self.asks.append((slot, self.clock.time_ns, velocity_rad_s))
        self.pending.append(
            Sample(
                slot,
                self.clock.time_ns,
                drive_answered_ns=self.clock.time_ns + 100_000,
                motor_position_rad=self.angle_rad,
                load_angle_rad=self.angle_rad,
            )
        )
        self.angle_rad += velocity_rad_s * PERIOD_NS / 1e9
        return self.clock.time_ns

    def samples(self, until_ns: int) -> list[Sample]:
        keep = self.late if until_ns < self.asks_end_ns else 0
        settled = self.pending[: len(self.pending) - keep]
        self.pending = self.pending[len(settled) :]
        return settled

    def finish(self) -> list[Sample]:
        return self.samples(self.asks_end_ns)

    asks_end_ns = 1 << 62

    def events(self) -> list[WireEvent]:
        told, self.told = self.told, []
        return told


def schedule(slots: int = 200, amplitude_rad_s: float = 1.0) -> Schedule:
    return Experiment(
        name="t",
        rig="none",
        period_s=0.008,
        memory=1,
        standstill_s=0.08,
        lead_in=5,
        identification=MSequence(
            polynomial="23", amplitude_rad_s=amplitude_rad_s, length=slots - 25
        ),
        validation=RandomBinary(
            kind="random-binary", seed=3, amplitude_rad_s=amplitude_rad_s, length=10
        ),
    ).schedule()


def play(
    holes_ns: Sequence[int] = (), late: int = 0, limits: Limits = WIDE
) -> tuple[IdealAxis, Any, list[tuple[str, dict[str, Any]]], int]:
    plan = schedule()
    axis = IdealAxis(JumpingClock(holes_ns), late)
    axis.asks_end_ns = plan.slots * PERIOD_NS
    told: list[tuple[str, dict[str, Any]]] = []
    with SlotTable.create(plan.slots) as table:
        player = Player(axis, plan, table, limits, axis.clock)
        player.play(0, lambda kind, text, **data: told.append((kind, data)))
        return axis, table.rows.copy(), told, table.done


def test_every_slot_is_played_once_at_its_deadline_with_its_own_command() -> None:
    axis, rows, told, done = play()
    plan = schedule()
    assert [slot for slot, _, _ in axis.asks] == list(range(plan.slots))
    assert all(at_ns == slot * PERIOD_NS for slot, at_ns, _ in axis.asks)
    np.testing.assert_array_equal([v for _, _, v in axis.asks], plan.velocity_rad_s)
    np.testing.assert_array_equal(rows["chip"], plan.chip)
    assert done == plan.slots
    assert told == []


@given(st.lists(st.integers(0, 40_000_000), max_size=60), st.integers(0, 3))
def test_after_a_hole_playing_goes_on_with_the_slot_whose_time_it_is(
    holes_ns: list[int], late: int
) -> None:
    axis, rows, told, done = play(holes_ns, late)
    plan = schedule()
    asks = [ask for ask in axis.asks if ask[0] < plan.slots]
    resting = axis.asks[len(asks) :]  # while what is late is waited for
    assert not any(command for _, _, command in resting)
    played = [slot for slot, _, _ in asks]
    skipped = [slot for kind, data in told for slot in range(data["slot"], data["to"])]
    assert sorted(played + skipped) == list(range(plan.slots))  # each slot once, played or said
    for slot, at_ns, velocity_rad_s in asks:  # never early, never in a later slot's time
        assert slot * PERIOD_NS <= at_ns < (slot + 1) * PERIOD_NS
        assert velocity_rad_s == plan.velocity_rad_s[slot]
    assert set(np.flatnonzero(rows["slot"] != UNPLAYED)) == set(played)
    assert done == plan.slots or skipped[-1] == plan.slots - 1
    lateness_s = rows["lateness_s"][played]
    np.testing.assert_allclose(
        lateness_s, [(at_ns - slot * PERIOD_NS) / 1e9 for slot, at_ns, _ in asks]
    )


def test_a_late_answer_lands_in_the_row_of_the_slot_that_asked() -> None:
    _, on_time, _, _ = play(late=0)
    _, late, _, _ = play(late=3)
    np.testing.assert_array_equal(late["load_angle_rad"], on_time["load_angle_rad"])
    np.testing.assert_allclose(late["drive_latency_s"], 100e-6)


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"velocity_rad_s": 0.5}, "velocity reached"),
        ({"travel_rad": 0.005}, "travel reached"),
        ({"run_time_s": 0.5}, "has lasted"),
    ],
)
def test_leaving_a_limit_ends_the_run_in_words(limits: dict[str, float], words: str) -> None:
    with pytest.raises(LimitError, match=words) as caught:
        play(limits=WIDE.model_copy(update=limits))
    assert "the rig was stopped" in str(caught.value)


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"velocity_rad_s": 0.5}, r"velocity would reach 57\.\d+ deg/s"),
        ({"travel_rad": 0.005}, "travel would reach"),
        ({"run_time_s": 0.5}, "run time would reach"),
    ],
)
def test_a_schedule_that_must_leave_a_limit_is_refused_before(
    limits: dict[str, float], words: str
) -> None:
    with pytest.raises(LimitError, match=words) as caught:
        check_schedule(schedule(), WIDE.model_copy(update=limits))
    assert "Nothing was enabled" in str(caught.value)


def test_a_fatal_event_ends_the_run_and_a_harmless_one_is_told() -> None:
    plan = schedule()
    axis = IdealAxis(JumpingClock())
    told: list[str] = []
    with SlotTable.create(plan.slots) as table:
        axis.told.append(WireEvent(1, "duplicate", "an answer came twice"))
        player = Player(axis, plan, table, WIDE, axis.clock)
        player.play(0, lambda kind, text, **data: told.append(kind))
        assert told == ["duplicate"]
        axis.told.append(WireEvent(2, "emergency", "EMCY 0x8130 from node 1.", fatal=True))
        with pytest.raises(WireError, match="0x8130"):
            player.play(axis.clock.time_ns, lambda kind, text, **data: told.append(kind))


def test_a_stop_that_is_asked_ends_the_run_at_the_next_slot() -> None:
    plan = schedule()
    axis = IdealAxis(JumpingClock())
    with SlotTable.create(plan.slots) as table:
        table.ask_stop()
        Player(axis, plan, table, WIDE, axis.clock).play(0, lambda kind, text, **data: None)
    assert axis.asks == []
