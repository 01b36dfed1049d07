"""What the Modbus master must be told about the drive, its line, and the period; all values."""

import math
from dataclasses import dataclass, field
from typing import Literal

from drivers.errors import SettingsError
from drivers.modbus.budget import check_period
from drivers.modbus.frames import request_bytes
from drivers.modbus.lines import Line, RtuLine, TcpLine
from drivers.modbus.plan import Plan, plan_of, unused_items
from drivers.modbus.profile import LOAD, TARGET, DriveProfile


@dataclass(frozen=True, slots=True)
class LoadEncoder:
    """The encoder behind the coupling, where it hangs on the drive (`load_position`)."""

    counts_per_revolution: int
    direction: Literal[1, -1] = 1


@dataclass(frozen=True, slots=True)
class ModbusDriveSettings:
    """A drive on Modbus; `profile` is its register map.

    `gear_ratio` is motor revolutions per revolution of the shaft that the bench calls motor angle,
    `direction` is -1 where the drive counts against the bench. `communication_timeout_s` goes into
    the drive's own watchdog; a drive that has none is refused unless `without_watchdog`
    acknowledges it. `rated_torque_nm` is needed where torque comes per mille and no register tells.
    """

    unit: int
    profile: DriveProfile
    counts_per_revolution: int
    gear_ratio: float = 1.0
    direction: Literal[1, -1] = 1
    rated_torque_nm: float | None = None
    load: LoadEncoder | None = None
    communication_timeout_s: float = 0.3
    without_watchdog: bool = False
    enable_timeout_s: float = 2.0
    stop_timeout_s: float = 2.0
    limits_temperature: bool = False


@dataclass(frozen=True, slots=True)
class ModbusSettings:
    """One axis: line, drive, and period.

    `answer_timeout_s` without any good answer ends the trust in the axis. `plan` follows.
    Raises SettingsError for what this drive on this line cannot do, the period first of all.
    """

    line: Line
    drive: ModbusDriveSettings
    period_s: float
    answer_timeout_s: float = 0.25
    stuck_travel_rad: float = math.radians(10.0)
    plan: Plan = field(init=False)

    def __post_init__(self) -> None:
        drive = self.drive
        self._check_drive()
        unused = unused_items(
            has_load=drive.load is not None, limits_temperature=drive.limits_temperature
        )
        plan = plan_of(drive.profile, unused)
        object.__setattr__(self, "plan", plan)
        check_period(drive.profile, self.line, plan, self.period_s)

    @property
    def command_after_s(self) -> float:
        """From the ask until the drive has the command: the first request's bytes on a serial line.

        Zero on a network, where nobody knows.
        """
        if not isinstance(self.line, RtuLine):
            return 0.0
        digits = dict(self.drive.profile.cycle.values) | {TARGET: 0}
        return request_bytes(self.plan.exchanges[0].request(digits)) * self.line.character_s

    def _check_drive(self) -> None:
        drive, profile = self.drive, self.drive.profile
        transport = "modbus-tcp" if isinstance(self.line, TcpLine) else "modbus-rtu"
        if transport not in profile.transports:
            raise SettingsError(
                f"{profile.title} has no {transport}: it speaks {', '.join(profile.transports)}. "
                "Correct drive.protocol."
            )
        if not 1 <= drive.unit <= 247:
            raise SettingsError(f"drive.unit = {drive.unit}: a Modbus unit id is 1 to 247.")
        if not profile.is_commanded:
            raise SettingsError(
                f"{profile.title} takes no velocity over Modbus as far as its profile knows: it "
                "can be read, not driven. Drive it another way, or add [cycle] write to a profile "
                "of your own."
            )
        if drive.load is not None and LOAD not in profile.items:
            raise SettingsError(
                f"{profile.title} has no second encoder (no [items.{LOAD}] in its profile), but "
                "drive.second_encoder asks for one. Take it out, or choose another profile."
            )
        self._check_watchdog()

    def _check_watchdog(self) -> None:
        drive, watchdog = self.drive, self.drive.profile.watchdog
        if watchdog is None:
            if not drive.without_watchdog:
                raise SettingsError(
                    f"{drive.profile.title} does not stop by itself when the bench dies: its "
                    "profile knows no communication timeout. Only with an emergency stop at hand, "
                    "set drive.without_watchdog = true to drive it all the same."
                )
            return
        timeout_s = self.own_stop_s
        shortest_s = max(3 * self.period_s, self.answer_timeout_s)
        if timeout_s is None or timeout_s > watchdog.range_s[1] or timeout_s < 3 * self.period_s:
            raise SettingsError(
                f"drive.communication_timeout_s = {drive.communication_timeout_s:g}: "
                f"{drive.profile.title} takes {watchdog.range_s[0]:g} to {watchdog.range_s[1]:g} s "
                f"in steps of {watchdog.unit_s:g} s, and it must bridge three periods "
                f"({3 * self.period_s:g} s). Choose about {shortest_s:g} s."
            )

    @property
    def own_stop_s(self) -> float | None:
        """When the drive stops by itself after its master's last word, rounded up to its steps."""
        watchdog = self.drive.profile.watchdog
        if watchdog is None:
            return None
        asked_s = max(self.drive.communication_timeout_s, watchdog.range_s[0])
        return math.ceil(asked_s / watchdog.unit_s - 1e-9) * watchdog.unit_s
