"""The vocabulary every protocol implements: one driven axis, commanded and sampled slot by slot.

A *slot* is one period of the experiment, counted from 0. The master asks for a sample in every
slot it plays (on CANopen: the SYNC); what answers carries the slot that asked for it, however
late it comes. A sample is taken *at* the ask: on a CiA 402 drive `motor_position_counts` of slot
k is the position at SYNC k, before the command of slot k has acted.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self


@dataclass(frozen=True, slots=True)
class Sample:
    """What one slot's ask brought back. A field that did not come is None.

    Times are CLOCK_MONOTONIC nanoseconds of this host, except `device_time_us`, the device's own
    sampling time (CiA 301 object 0x1013, microseconds, wrapping at 2**32). Counts are unwrapped:
    they run on over the device's range. Angles and velocities are in the direction the rig's
    configuration calls positive. `motor_sampled_ns` and `load_sampled_ns` are when the angles were
    taken: at the ask where SYNC takes them, later by the request's bytes on a serial line, None
    where nobody knows.
    """

    slot: int
    asked_ns: int
    drive_answered_ns: int | None = None
    encoder_answered_ns: int | None = None
    device_time_us: int | None = None
    statusword: int | None = None
    motor_position_counts: int | None = None
    motor_position_rad: float | None = None
    motor_velocity_rad_s: float | None = None
    motor_torque_nm: float | None = None
    motor_current_a: float | None = None
    motor_sampled_ns: int | None = None
    load_sampled_ns: int | None = None
    load_angle_counts: int | None = None
    load_angle_rad: float | None = None
    drive_temperature_c: float | None = None


@dataclass(frozen=True, slots=True)
class WireEvent:
    """Something on the wire that is no sample: an emergency, a reboot, a silent node.

    `fatal` means the axis can no longer be trusted: leave it now.
    """

    time_ns: int
    kind: str
    text: str
    fatal: bool = False


StopAsked = Callable[[], bool]
"""Whether whoever enters an axis wants it stopped by now."""


def never() -> bool:
    """No stop is asked."""
    return False


class Axis(Protocol):
    """A drive and the encoder behind its coupling. Enter = enabled, leave = stopped and disabled.

    Leaving sends quick stop, zero velocity, and disable, whatever was raised, and never hides
    the exception that led there. One thread uses an axis; nothing in it blocks for longer than
    its argument says.
    """

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...

    @property
    def may_be_powered(self) -> bool:
        """Whether the drive may have power: from enabling until it has confirmed its stop."""
        ...

    def command(self, velocity_rad_s: float, slot: int) -> int:
        """Send the set-point of this slot and ask for its sample; return the ask's time in ns."""
        ...

    def samples(self, until_ns: int) -> Sequence[Sample]:
        """Samples settled since the last call, in slot order.

        Returns as soon as nothing is outstanding, at the latest at `until_ns`. Every slot that
        was asked comes back exactly once, sooner or later; parts that never came are None.
        """
        ...

    def finish(self) -> Sequence[Sample]:
        """No slot is asked any more: the samples that have not settled, at once, with what has come
        of them. What was counted only is told in `events` after it."""
        ...

    def events(self) -> Sequence[WireEvent]:
        """What else happened on the wire since the last call."""
        ...
