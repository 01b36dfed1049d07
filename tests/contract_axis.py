"""What every `drivers.axis.Axis` must do, whatever wire it is on.

    check_axis(make_axis, is_enabled, period_s=...)

`make_axis` returns a new axis of the same drive each time, `is_enabled` asks the drive itself (not
the axis) whether its power stage is on. Nothing here depends on how punctual the machine is.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

from drivers.axis import Axis, Sample, WireEvent
from drivers.clock import SYSTEM_CLOCK, Clock

_PATIENCE_S = 3.0


class BodyError(Exception):
    """Stands for whatever may be raised in the body."""


def check_axis(
    make_axis: Callable[[], Axis],
    is_enabled: Callable[[], bool],
    *,
    period_s: float,
    clock: Clock = SYSTEM_CLOCK,
    velocity_rad_s: float = 2.0,
) -> None:
    """Raise AssertionError where an axis breaks the promise of its protocol."""
    _check_motion(make_axis, is_enabled, period_s, clock, velocity_rad_s)
    _check_leaves_disabled(make_axis, is_enabled, BodyError("the body failed"))
    _check_leaves_disabled(make_axis, is_enabled, KeyboardInterrupt())


def play(
    axis: Axis, velocities_rad_s: Sequence[float], period_s: float, clock: Clock = SYSTEM_CLOCK
) -> list[Sample]:
    """Play velocities from slot 0 on, at absolute deadlines; every sample, however late."""
    period_ns = round(period_s * 1e9)
    start_ns = clock.now_ns()
    samples: list[Sample] = []
    for slot, velocity_rad_s in enumerate(velocities_rad_s):
        deadline_ns = start_ns + slot * period_ns
        clock.sleep_until(deadline_ns)
        before_ns = clock.now_ns()
        asked_ns = axis.command(velocity_rad_s, slot)
        assert before_ns <= asked_ns <= clock.now_ns()
        samples += axis.samples(deadline_ns + period_ns)
    end_ns = clock.now_ns() + round(_PATIENCE_S * 1e9)
    while len(samples) < len(velocities_rad_s) and clock.now_ns() < end_ns:
        samples += axis.samples(clock.now_ns() + period_ns)
    return samples


def _check_motion(
    make_axis: Callable[[], Axis],
    is_enabled: Callable[[], bool],
    period_s: float,
    clock: Clock,
    velocity_rad_s: float,
) -> None:
    still, moving = 5, 40
    velocities = [0.0] * still + [velocity_rad_s] * moving + [0.0] * moving
    assert not is_enabled()
    with make_axis() as axis:
        assert is_enabled()
        assert axis.may_be_powered
        samples = play(axis, velocities, period_s, clock)
        assert [sample.slot for sample in samples[: len(velocities)]] == list(
            range(len(velocities))
        )
        assert all(a.asked_ns < b.asked_ns for a, b in pairwise(samples))
        answered = [s for s in samples if s.drive_answered_ns is not None]
        assert len(answered) >= len(velocities) // 2, "most slots must be answered"
        assert all((s.drive_answered_ns or 0) >= s.asked_ns for s in answered)
        positions = {s.slot: s.motor_position_rad for s in answered}
        _check_travel(positions, still, moving)
        axis.command(0.0, len(velocities))
        assert [sample.slot for sample in axis.finish()] == [len(velocities)], "what is open"
        assert not axis.finish()
        _check_events_drain_once(axis)
    assert not is_enabled()
    assert not axis.may_be_powered


def _check_travel(positions: dict[int, float | None], still: int, moving: int) -> None:
    """Positive velocity moves to positive angles, zero velocity holds still again."""
    known = {slot: p for slot, p in positions.items() if p is not None}
    start = known[min(known)]
    middle = max(slot for slot in known if slot < still + moving)
    end = max(slot for slot in known if slot < still + 2 * moving)
    settled = min(slot for slot in known if slot > end - moving // 4)
    assert known[middle] > start
    travel = known[middle] - start
    assert abs(known[end] - known[settled]) < 0.1 * travel


def _check_events_drain_once(axis: Axis) -> None:
    first = list(axis.events())
    assert all(isinstance(event, WireEvent) and event.text for event in first)
    assert not any(event.fatal for event in first), first
    again = list(axis.events())
    assert not set(first) & set(again)


def _check_leaves_disabled(
    make_axis: Callable[[], Axis], is_enabled: Callable[[], bool], error: BaseException
) -> None:
    """Leaving disables and never hides what the body raised."""
    try:
        with make_axis() as axis:
            assert is_enabled()
            axis.command(1.0, 0)
            raise error
    except (BodyError, KeyboardInterrupt) as raised:
        assert raised is error  # noqa: PT017 (BaseException: pytest.raises would do, but reads worse)
    else:
        raise AssertionError("leaving an axis must not swallow what was raised")
    assert not is_enabled()
