"""Does that move which should? Catches an encoder that sticks and a drive that only says it turns.

Three angles tell of one shaft: the commanded one (the integral of the velocity sent), the motor's,
and the load's. One that stays within a few counts, for several samples (one that turns around is
twice at the same place), while the one that leads it has moved by `travel_rad` is stuck. The
travel must be wider than all play and twist between motor and load: two encoders whose distance
has changed by more than `DISAGREE` times that since the first look disagree (a wrong count per
revolution, a wrong sign, a coupling that slips; one that sticks is named before).

A motor that moves, but not as commanded, is found by the difference of the two velocities,

    e' = (v_command - v_motor) - e / T,    trips at |e| > travel_rad + LAG_S * peak |v_command|

with T = FORGET_S: it allows a drive to be late by LAG_S, and slow drift of any length.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

_STILL_COUNTS = 3
_STILL_SAMPLES = 8
FORGET_S = 0.5
LAG_S = 0.15
DISAGREE = 1.5
Tell = Callable[[str, str], None]


@dataclass(slots=True)
class _Follower:
    """An angle in counts, and how far its leader has gone since it moved last."""

    anchor: int | None = None
    samples: int = 0
    low_rad: float = 0.0
    high_rad: float = 0.0

    def led_rad(self, counts: int, leader_rad: float) -> float:
        """The leader's travel, to both sides, since this angle last changed; 0 for a short stay."""
        if self.anchor is None or abs(counts - self.anchor) > _STILL_COUNTS:
            self.anchor = counts
            self.samples = 0
            self.low_rad = self.high_rad = leader_rad
        self.samples += 1
        self.low_rad = min(self.low_rad, leader_rad)
        self.high_rad = max(self.high_rad, leader_rad)
        return self.high_rad - self.low_rad if self.samples >= _STILL_SAMPLES else 0.0


@dataclass(slots=True)
class _Following:
    """The leaky integral of the velocity error, and the command's recent peak."""

    error_rad: float = 0.0
    peak_rad_s: float = 0.0
    before: tuple[float, float, float] | None = None

    def exceeds(
        self, time_s: float, commanded_rad: float, motor_rad: float, travel_rad: float
    ) -> bool:
        """Whether the motor has gone elsewhere than commanded."""
        before, self.before = self.before, (time_s, commanded_rad, motor_rad)
        if before is None:
            return False
        elapsed_s = max(time_s - before[0], 1e-6)
        commanded_by_rad = commanded_rad - before[1]
        left = math.exp(-elapsed_s / FORGET_S)
        self.error_rad = self.error_rad * left + commanded_by_rad - (motor_rad - before[2])
        self.peak_rad_s = max(self.peak_rad_s * left, abs(commanded_by_rad) / elapsed_s)
        return abs(self.error_rad) > travel_rad + LAG_S * self.peak_rad_s


@dataclass(slots=True)
class Plausibility:
    """Looks at every sample; `tell(kind, text)` hears of what cannot be."""

    travel_rad: float
    drive: str
    tell: Tell
    _motor_by_command: _Follower = field(default_factory=_Follower)
    _motor_by_load: _Follower = field(default_factory=_Follower)
    _load_by_motor: _Follower = field(default_factory=_Follower)
    _following: _Following = field(default_factory=_Following)
    _apart_rad: float | None = None  # load from motor, at the first look

    def look(
        self,
        time_s: float,
        commanded_rad: float,
        motor: tuple[int, float] | None,
        load: tuple[int, float] | None,
    ) -> None:
        """One slot: time and commanded angle, counts and angle of each encoder that answered."""
        if motor is not None and load is not None:
            if self._load_by_motor.led_rad(load[0], motor[1]) > self.travel_rad:
                self.tell(
                    "load does not move",
                    f"the load's encoder has stayed at {load[0]} counts while the motor turned by "
                    f"{self.travel_rad:.3g} rad: the encoder is stuck, or the coupling is open. "
                    "Check both.",
                )
            if self._motor_by_load.led_rad(motor[0], load[1]) > self.travel_rad:
                self.tell(
                    "motor encoder stuck",
                    f"{self.drive}: the motor's position has stayed at {motor[0]} counts while the "
                    f"load turned by {self.travel_rad:.3g} rad. Check the motor's encoder.",
                )
            self._compare(motor[1], load[1])
        if motor is not None:
            led_rad = self._motor_by_command.led_rad(motor[0], commanded_rad)
            if led_rad > self.travel_rad:
                self.tell(
                    "motor does not move",
                    f"{self.drive} says that it follows, but the motor's position has stayed at "
                    f"{motor[0]} counts while {led_rad:.3g} rad were commanded: the power stage is "
                    "off, the shaft is blocked, or the motor's encoder is stuck.",
                )
            elif self._following.exceeds(time_s, commanded_rad, motor[1], self.travel_rad):
                self.tell(
                    "motor does not follow",
                    f"{self.drive} says that it follows, but the motor is "
                    f"{abs(self._following.error_rad):.3g} rad away from where its command led it "
                    f"in the last {FORGET_S:g} s: commands are lost on their way, or the drive "
                    "limits, filters, or ramps them. Check the bus and the drive's limits.",
                )

    def _compare(self, motor_rad: float, load_rad: float) -> None:
        """Have the two encoders drifted apart by more than play and twist?"""
        apart_rad = load_rad - motor_rad
        if self._apart_rad is None:
            self._apart_rad = apart_rad
        drifted_rad, allowed_rad = apart_rad - self._apart_rad, DISAGREE * self.travel_rad
        if abs(drifted_rad) > allowed_rad:
            self.tell(
                "encoders disagree",
                f"the load's encoder has left the motor's by {drifted_rad:.3g} rad since the "
                f"start, allowed {allowed_rad:.3g} rad ({DISAGREE} x drive.stuck_travel_rad): a "
                "wrong counts_per_revolution, direction, or gear_ratio, a lost count, or a "
                "coupling that slips. Check them: servo-bench doctor --move turns the shaft.",
            )
