"""The rig's limits: checked on the whole schedule before anything is enabled, and in every slot.

The bus loop checks every sample as it comes; the supervisor checks the same samples again, with the
same `Guard`, in another process.

This is no safety function: a rig needs a hard-wired emergency stop or STO of its own.
"""

import math
from dataclasses import dataclass, field

from drivers.axis import Sample
from servo_bench.clock import NS_PER_S
from servo_bench.errors import LimitError
from servo_bench.excitation.experiment import Schedule
from servo_bench.rig import Limits

DEVICE_TIME_RANGE_US = 1 << 32
"""Where CiA 301's 0x1013 wraps."""
LEAST_BLIND_PERIODS = 3
STOP_GRACE_S = 5.0
"""How long a run's processes may take to end, beyond what the drive itself may."""


def check_schedule(schedule: Schedule, limits: Limits) -> None:
    """Raise LimitError where playing the schedule must leave the limits."""
    _within(
        "the commanded velocity",
        math.degrees(schedule.peak_velocity_rad_s),
        math.degrees(limits.velocity_rad_s),
        "deg/s",
        remedy="Lower the amplitude, or raise limits.velocity_deg_s if the rig allows it.",
    )
    _within(
        "the commanded travel",
        math.degrees(schedule.peak_travel_rad),
        math.degrees(limits.travel_rad),
        "deg",
        remedy="Lower the amplitude or the period, or raise limits.travel_deg.",
    )
    check_run_time(schedule.duration_s, limits)


def check_run_time(duration_s: float, limits: Limits) -> None:
    """Raise LimitError for what is too long for the rig."""
    remedy = "Play fewer periods, or raise limits.run_time_s."
    _within("the run time", duration_s, limits.run_time_s, "s", remedy=remedy)


def _within(what: str, got: float, allowed: float, unit: str, *, remedy: str) -> None:
    if got > allowed:
        raise LimitError(
            f"{what} would reach {got:.6g} {unit}, the rig's limit is {allowed:.6g} {unit}. "
            f"{remedy} Nothing was enabled."
        )


def blind_s(limits: Limits, period_s: float) -> float:
    """The longest time without a slot: `limits.blind_s`, and at least three periods."""
    return max(limits.blind_s, LEAST_BLIND_PERIODS * period_s)


def check_missed(missed: int, slot: int, period_s: float, limits: Limits) -> None:
    """Raise LimitError where so many cycles in a row, up to `slot`, are longer than allowed."""
    allowed_s = blind_s(limits, period_s)
    if missed * period_s > allowed_s:
        raise LimitError(
            f"{missed} slots in a row were missed before slot {slot}, {missed * period_s:.3g} s "
            f"without a command; limits.blind_s allows {allowed_s:g} s: the rig was stopped. "
            "Give the bus loop its SCHED_FIFO priority and a processor of its own (servo-bench "
            "doctor), or choose a longer period."
        )


@dataclass(slots=True)
class Guard:
    """Watches the samples of a run; `breach` says in words which limit was left, or None.

    Travel is counted from the first sample. Velocity is the angle's difference over the time
    between the two samples: for a load whose counter is asked beside the drive, between when its
    counts were taken; else by the device's own clock where both came with one, or the longer of the
    time between the asks and the time between the answers. It is half a period at the least, so
    that a frame that was held up on its way is no velocity. A device's clock is believed as far as
    the bench's own allows: a sample is taken after its ask and before its answer, and where the
    drive produces SYNC, which is seen late, slots tell the time.
    """

    limits: Limits
    period_s: float
    start_ns: int
    _first: dict[str, float] = field(default_factory=dict)
    _last: dict[str, tuple[Sample, float]] = field(default_factory=dict)

    def breach(self, sample: Sample) -> str | None:
        """The first limit that this sample has left, as a sentence."""
        for name, angle_rad in (
            ("motor", sample.motor_position_rad),
            ("load", sample.load_angle_rad),
        ):
            if angle_rad is not None:
                found = self._angle_breach(name, angle_rad, sample)
                if found:
                    return found
        torque_nm, allowed_nm = sample.motor_torque_nm, self.limits.torque_nm
        if torque_nm is not None and allowed_nm is not None and abs(torque_nm) > allowed_nm:
            return (
                f"the motor's torque reached {torque_nm:.4g} N m in slot {sample.slot}, the limit "
                f"is {allowed_nm:.4g} N m"
            )
        hot_c, allowed_c = sample.drive_temperature_c, self.limits.drive_temperature_c
        if hot_c is not None and allowed_c is not None and hot_c > allowed_c:
            return (
                f"the drive's temperature reached {hot_c:.1f} °C in slot {sample.slot}, the limit "
                f"is {allowed_c:g} °C"
            )
        elapsed_s = (sample.asked_ns - self.start_ns) / NS_PER_S
        if elapsed_s > self.limits.run_time_s:
            return (
                f"the run has lasted {elapsed_s:.3f} s in slot {sample.slot}, "
                f"the limit is {self.limits.run_time_s:.3f} s"
            )
        return None

    def _angle_breach(self, name: str, angle_rad: float, sample: Sample) -> str | None:
        travel_rad = angle_rad - self._first.setdefault(name, angle_rad)
        then, then_rad = self._last.get(name, (sample, angle_rad))
        self._last[name] = (sample, angle_rad)
        velocity_rad_s = (angle_rad - then_rad) / self._elapsed_s(name, then, sample)
        for what, got, allowed, unit in (
            ("travel", travel_rad, self.limits.travel_rad, "deg"),
            ("velocity", velocity_rad_s, self.limits.velocity_rad_s, "deg/s"),
        ):
            if abs(got) > allowed:
                return (
                    f"the {name}'s {what} reached {math.degrees(got):.6g} {unit} in slot "
                    f"{sample.slot}, the limit is {math.degrees(allowed):.6g} {unit}"
                )
        return None

    def _elapsed_s(self, name: str, then: Sample, now: Sample) -> float:
        taken_ns = [_taken_apart(sample) if name == "load" else None for sample in (then, now)]
        if taken_ns[0] is not None and taken_ns[1] is not None:
            elapsed_s = (taken_ns[1] - taken_ns[0]) / NS_PER_S
        elif then.device_time_us is not None and now.device_time_us is not None:
            told_s = ((now.device_time_us - then.device_time_us) % DEVICE_TIME_RANGE_US) * 1e-6
            longest_s = (_answered(now) - then.asked_ns) / NS_PER_S
            elapsed_s = min(told_s, max(longest_s, (now.slot - then.slot) * self.period_s))
        else:
            elapsed_s = (
                max(now.asked_ns - then.asked_ns, _answered(now) - _answered(then)) / NS_PER_S
            )
        return max(elapsed_s, self.period_s / 2)


def _taken_apart(sample: Sample) -> int | None:
    """When the load's angle was taken where that was not with the drive's: by a counter beside it,
    whose time the drive's clock does not tell."""
    taken_ns = sample.load_sampled_ns
    return None if taken_ns in (sample.motor_sampled_ns, sample.asked_ns) else taken_ns


def _answered(sample: Sample) -> int:
    """When the sample's last part came; its ask where none did."""
    return max(sample.drive_answered_ns or 0, sample.encoder_answered_ns or 0) or sample.asked_ns
