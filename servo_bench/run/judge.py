"""What the supervisor thinks of a run: pure, given the slot table, the wire's own words, the time.

First line of defence is the bus loop, which checks every sample as it comes and stops the rig by
itself. What it should have seen and has not acted on after `grace_s` is a trip, and so is all that
it cannot see: that it hangs, or has died.

    kind                when
    loop ended          its process is gone while the drive may be powered
    stop unconfirmed    it has ended in words, and the drive did not confirm to it that it stands
    loop hung           no slot begun for limits.blind_s, while the last answers are waited for
                        too; enabling, or a stop, that takes longer than it can
    stop ignored        the operator asked for a stop, and it plays on
    limit               travel, velocity, torque, run time, temperature
    drive               a statusword that is not enabled, an emergency, a restart
    implausible         following error, encoder disagreement, a stuck encoder
    bus silent          no answer of the drive, or of the load's encoder once it has answered, to
                        any slot for longer than the axis itself allows; time in which no slot was
                        begun, which limits.blind_s bounds, is no silence
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.axis import Sample, WireEvent
from drivers.plausible import Plausibility
from servo_bench.clock import NS_PER_S
from servo_bench.errors import BenchError, DriveError, LimitError, WireError
from servo_bench.rig import RigConfig
from servo_bench.run.axes import enabled_bits
from servo_bench.run.limits import Guard, blind_s
from servo_bench.run.rows import read_sample
from servo_bench.run.table import UNPLAYED, SlotTable, Stage, Trip

KINDS: dict[str, type[BenchError]] = {
    "loop ended": WireError,
    "stop unconfirmed": WireError,
    "loop hung": WireError,
    "stop ignored": WireError,
    "limit": LimitError,
    "drive": DriveError,
    "implausible": WireError,
    "bus silent": WireError,
}
"""What each kind of trip is raised as."""

ANSWER_PATIENCE_S = 0.4
"""The axis itself gives up after 0.25 s without an answer."""
STOP_PATIENCE_S = 5.0
_ENDING = (Stage.STOPPING, Stage.UNCONFIRMED)
_POWERED = (Stage.ENABLING, Stage.PLAYING, Stage.RESTING, *_ENDING)


@dataclass(frozen=True, slots=True)
class _Pending:
    """Something the loop should act on, and since when the supervisor knows of it."""

    trip: Trip
    since_ns: int


class Judge:
    """Looks at a run again and again; `look` says why the rig must be stopped now, or None."""

    def __init__(self, rig: RigConfig, period_s: float) -> None:
        self._limits = rig.limits
        self.period_s = period_s
        self._enabled_mask, self._enabled = enabled_bits(rig, period_s)
        self._stop_patience_s = (
            STOP_PATIENCE_S + rig.drive.enable_timeout_s + 2 * rig.drive.stop_timeout_s
        )
        self._enable_patience_s = 2 * self._stop_patience_s  # a drive may refuse, and be left
        self.grace_s = 2 * period_s + 0.02
        self._plausible = Plausibility(rig.drive.stuck_travel_rad, "the drive", self._cannot_be)
        self._guard: Guard | None = None
        self._seen = 0
        self._commanded_rad = 0.0
        self._before: tuple[int, float] | None = None  # ask and command of the row before
        self._answered_ns: int | None = None
        self._load_ns: int | None = None
        self._beat_ns = 0
        self._stage = Stage.STARTING
        self._stage_ns = 0
        self._stop_ns: int | None = None
        self._pending: _Pending | None = None
        self._found: Trip | None = None

    @property
    def wants_temperature(self) -> bool:
        """Whether the drive's temperature has a limit, and the run is at a point to ask."""
        return self._limits.drive_temperature_c is not None and self._stage == Stage.PLAYING

    def look(
        self,
        now_ns: int,
        table: SlotTable,
        *,
        loop_is_gone: bool,
        heard: Sequence[WireEvent] = (),
        temperature_c: float | None = None,
    ) -> Trip | None:
        """The cause to stop for, or None."""
        stage = table.stage
        if stage != self._stage:
            self._stage, self._stage_ns = stage, now_ns
        if loop_is_gone:
            return self._orphaned(table) if stage in _POWERED else None
        if stage in _ENDING and now_ns - self._stage_ns > self._stop_patience_s * NS_PER_S:
            return Trip(
                "loop hung",
                f"the bus loop has been stopping the rig for more than {self._stop_patience_s:g} "
                "s.",
            )
        if stage == Stage.ENABLING:
            return self._while_enabling(now_ns, table)
        if stage not in (Stage.PLAYING, Stage.RESTING):
            return None
        hung = self._hung(now_ns, table)
        if hung or stage == Stage.RESTING:
            return hung
        return self._while_playing(now_ns, table, heard, temperature_c)

    def _while_enabling(self, now_ns: int, table: SlotTable) -> Trip | None:
        """Set-up has no bound, and no power; the loop beats from when it begins to enable."""
        if not table.beat_ns or now_ns - table.beat_ns <= self._enable_patience_s * NS_PER_S:
            return None
        return Trip(
            "loop hung",
            "the bus loop has been enabling the drive, or stopping it again, for more than "
            f"{self._enable_patience_s:g} s.",
        )

    def _hung(self, now_ns: int, table: SlotTable) -> Trip | None:
        blind_ns, allowed_s = now_ns - table.beat_ns, blind_s(self._limits, self.period_s)
        if blind_ns <= allowed_s * NS_PER_S:
            return None
        return Trip(
            "loop hung",
            f"the bus loop has begun no slot for {blind_ns / NS_PER_S:.3f} s after slot "
            f"{table.slot}, limits.blind_s allows {allowed_s:g} s: it hangs, or the "
            "machine gives it no time. See what else runs on it, and servo-bench doctor.",
        )

    def _orphaned(self, table: SlotTable) -> Trip:
        if table.stage == Stage.UNCONFIRMED:
            return Trip(
                "stop unconfirmed",
                f"the bus loop ended in slot {table.slot} without the drive's word that it stands.",
            )
        return Trip(
            "loop ended",
            f"the bus process ended without a word in slot {table.slot}, while the drive may have "
            "been powered; look at the terminal for a traceback.",
        )

    def _while_playing(
        self,
        now_ns: int,
        table: SlotTable,
        heard: Sequence[WireEvent],
        temperature_c: float | None,
    ) -> Trip | None:
        if table.stop_asked:
            self._stop_ns = self._stop_ns or now_ns
            if now_ns - self._stop_ns > blind_s(self._limits, self.period_s) * NS_PER_S:
                return Trip("stop ignored", "a stop was asked, and the bus loop plays on.")
        self._forgive_hole(table.beat_ns)
        found = (
            self._judge_rows(table)
            or self._judge_heard(heard)
            or self._judge_temperature(temperature_c)
            or self._judge_silence(table)
        )
        if found and self._pending is None:
            self._pending = _Pending(found, now_ns)
        pending = self._pending
        if pending and now_ns - pending.since_ns > self.grace_s * NS_PER_S:
            return pending.trip
        return None

    def _judge_rows(self, table: SlotTable) -> Trip | None:
        done = table.done
        rows = table.rows[self._seen : done]
        self._seen = done
        for row in rows:
            if row["slot"] == UNPLAYED:
                continue
            found = self._judge_sample(read_sample(row), float(row["velocity_command_rad_s"]))
            if found:
                return found
        return None

    def _judge_sample(self, sample: Sample, commanded_rad_s: float) -> Trip | None:
        if self._guard is None:
            self._guard = Guard(self._limits, self.period_s, sample.asked_ns)
        if self._before is not None:
            elapsed_s = (sample.asked_ns - self._before[0]) / NS_PER_S
            self._commanded_rad += self._before[1] * elapsed_s
        self._before = sample.asked_ns, commanded_rad_s
        breach = self._guard.breach(sample)
        if breach:
            return Trip("limit", f"{breach}.")
        if sample.statusword is not None:
            self._answered_ns = sample.asked_ns
            if sample.statusword & self._enabled_mask != self._enabled:
                return Trip(
                    "drive",
                    f"the drive is no longer enabled (statusword 0x{sample.statusword:04X} in slot "
                    f"{sample.slot}): see its display.",
                )
        if sample.load_angle_rad is not None:
            self._load_ns = sample.asked_ns
        self._plausible.look(
            sample.asked_ns / NS_PER_S,
            self._commanded_rad,
            _pair(sample.motor_position_counts, sample.motor_position_rad),
            _pair(sample.load_angle_counts, sample.load_angle_rad),
        )
        return self._found

    def _cannot_be(self, kind: str, text: str) -> None:
        self._found = self._found or Trip("implausible", f"{kind}: {text}")

    @staticmethod
    def _judge_heard(heard: Sequence[WireEvent]) -> Trip | None:
        fatal = [event for event in heard if event.fatal]
        return Trip("drive", fatal[0].text) if fatal else None

    def _judge_temperature(self, temperature_c: float | None) -> Trip | None:
        limit_c = self._limits.drive_temperature_c
        if temperature_c is None or limit_c is None or temperature_c <= limit_c:
            return None
        return Trip(
            "limit",
            f"the drive's temperature reached {temperature_c:.1f} °C, the limit is {limit_c:g} °C. "
            "Let it cool; lower the amplitude.",
        )

    def _forgive_hole(self, beat_ns: int) -> None:
        """Where no slot was begun for three periods or more nobody was asked: that is no
        silence."""
        hole_ns = beat_ns - self._beat_ns
        if self._beat_ns and hole_ns > 3 * self.period_s * NS_PER_S:
            if self._answered_ns is not None:
                self._answered_ns += hole_ns
            if self._load_ns is not None:
                self._load_ns += hole_ns
        self._beat_ns = beat_ns

    def _judge_silence(self, table: SlotTable) -> Trip | None:
        for who, answered_ns in (
            ("drive", self._answered_ns),
            ("load's encoder", self._load_ns),
        ):
            silent_s = 0.0 if answered_ns is None else (table.beat_ns - answered_ns) / NS_PER_S
            if silent_s > max(ANSWER_PATIENCE_S, 3 * self.period_s):
                return Trip(
                    "bus silent",
                    f"the {who} has answered no slot for {silent_s:.2f} s, in slot {table.slot}. "
                    "Check cable, termination, and supply.",
                )
        return None


def _pair(counts: int | None, angle_rad: float | None) -> tuple[int, float] | None:
    if counts is None or angle_rad is None or not math.isfinite(angle_rad):
        return None
    return counts, angle_rad
