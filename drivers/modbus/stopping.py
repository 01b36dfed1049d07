"""Stopping a drive over a line, whoever opened it: the axis, or who watches it.

target velocity 0 → [[stop]] → at rest → [[disable]] → communication timeout off
"""

import math
from contextlib import suppress

from drivers.clock import Clock
from drivers.errors import DriveError, DriverError
from drivers.modbus import profile as names
from drivers.modbus.lines import TcpLine
from drivers.modbus.link import Link
from drivers.modbus.rtu import RtuLink
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.setup import Registers
from drivers.modbus.tcp import TcpLink

STANDSTILL_RAD_S = 0.05
"""A shaft slower than this, between two readings, is believed to stand."""
_LOOK_S = 0.02
_STANDSTILL_COUNTS = 1


def open_link(settings: ModbusSettings, clock: Clock) -> Link:
    """The drive's line, opened. WireError where nothing is there."""
    drive = settings.drive
    if isinstance(settings.line, TcpLine):
        return TcpLink(settings.line, drive.unit, clock)
    silence_s = drive.profile.timing.silent_interval_s
    return RtuLink(settings.line, drive.unit, silence_s, clock)


def stop_anew(settings: ModbusSettings, clock: Clock) -> str | None:
    """`stop_over` a line that is opened for it and closed; never raises a DriverError."""
    try:
        link = open_link(settings, clock)
    except DriverError as error:
        return not_confirmed(settings, str(error))
    try:
        return stop_over(link, settings, clock)
    except DriverError as error:
        return not_confirmed(settings, str(error))
    finally:
        link.close()


def stop_over(link: Link, settings: ModbusSettings, clock: Clock) -> str | None:
    """Bring the drive to rest and power it off; what is wrong, or None when it is confirmed.

    Raises WireError where the line fails, DriveError where the drive refuses to stop or to be
    disabled; whatever it refuses before, it is told to be disabled.
    """
    link.abandon()
    registers = Registers(link, settings, clock)
    drive, profile = settings.drive, settings.drive.profile
    until_ns = clock.now_ns() + round(drive.stop_timeout_s * 1e9)
    try:
        with suppress(DriveError):  # what it takes no velocity for, the stop says again
            registers.write(names.TARGET, 0)
        registers.follow(profile.stop, until_ns)
        stands = _stands(registers, settings, clock, until_ns)
    finally:  # a drive that does not stop is switched off all the same
        registers.follow(profile.disable, until_ns + round(drive.stop_timeout_s * 1e9))
    status = registers.status()
    if profile.bits.enabled.hold(status):
        return not_confirmed(settings, f"its statusword is still 0x{status:04X}")
    if not stands:
        return not_confirmed(settings, "its position says that the shaft still turns: it coasts")
    if profile.watchdog is not None:
        registers.write(profile.watchdog.item, 0)
    return None


def _stands(registers: Registers, settings: ModbusSettings, clock: Clock, until_ns: int) -> bool:
    """Whether two readings of the position, a while apart, are the same."""
    drive = settings.drive
    rad_per_count = math.tau / (drive.counts_per_revolution * drive.gear_ratio)
    modulus = drive.profile.items[names.POSITION].modulus
    before = int(registers.state()[names.POSITION])
    before_ns = clock.now_ns()
    while True:
        clock.sleep_s(_LOOK_S)
        position = int(registers.state()[names.POSITION])
        now_ns = clock.now_ns()
        moved = abs((position - before + modulus // 2) % modulus - modulus // 2)
        slow = moved * rad_per_count / ((now_ns - before_ns) * 1e-9) < STANDSTILL_RAD_S
        if slow or moved <= _STANDSTILL_COUNTS:
            return True
        if now_ns >= until_ns:
            return False
        before, before_ns = position, now_ns


def not_confirmed(settings: ModbusSettings, reason: str) -> str:
    """The sentence for a stop that nobody saw."""
    own_stop_s, watchdog = settings.own_stop_s, settings.drive.profile.watchdog
    own_stop = (
        "it has no communication timeout and may still turn"
        if own_stop_s is None or watchdog is None
        else f"{watchdog.action} {own_stop_s:g} s after its master's last word"
    )
    return (
        f"drive {settings.drive.unit} did not confirm its stop ({reason.rstrip('.')}). If it is "
        f"still powered: {own_stop}. Use the emergency stop if the shaft turns."
    )
