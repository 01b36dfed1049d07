"""Counts on the wire, SI in the bench.

    angle     rad    = direction · counts · 2π / (counts per revolution · gear ratio)
    velocity  rad/s  = direction · wire value · unit / gear ratio
    torque    N m    = direction · per mille (0x6077) · rated torque (0x6076, mN m) · 1e-6

`unit`, in rad/s, is what 0x60A9 says one digit of 0x60FF and 0x606C is worth at the motor shaft:
exponent (bits 31..24, signed) | numerator (23..16) | denominator (15..8), CiA 303-2 codes.
Torque and current are the motor's own; the gear ratio does not enter them.
"""

import math
from dataclasses import dataclass
from fractions import Fraction

from drivers.errors import SettingsError

INCREMENTS_PER_SECOND = 0x00B50300
RPM = 0x00B44700
MILLI_RPM = 0xFDB44700

_REVOLUTION, _INCREMENT = 0xB4, 0xB5
_SECONDS = {0x03: 1.0, 0x47: 60.0}


def velocity_unit_rad_s(si_unit: int, counts_per_revolution: int) -> float:
    """What one digit of velocity is worth, in rad/s at the motor shaft, by object 0x60A9.

    Raises SettingsError for a unit that is neither revolutions nor increments per second or
    minute, times a power of ten.
    """
    exponent = (si_unit >> 24) - (256 if si_unit >> 31 else 0)
    numerator, denominator = (si_unit >> 16) & 0xFF, (si_unit >> 8) & 0xFF
    seconds = _SECONDS.get(denominator)
    if seconds is None or numerator not in (_REVOLUTION, _INCREMENT):
        raise SettingsError(
            f"the drive's velocity unit (0x60A9) is 0x{si_unit:08X}, which this master does not "
            f"know. It knows 10^n times revolutions or increments, per second or minute, e.g. "
            f"0x{INCREMENTS_PER_SECOND:08X} increments/s, 0x{RPM:08X} rpm, 0x{MILLI_RPM:08X} "
            f"milli-rpm. Set 0x60A9 in the drive to one of these."
        )
    turns = 1.0 if numerator == _REVOLUTION else 1.0 / counts_per_revolution
    return float(10.0**exponent * turns * 2.0 * math.pi / seconds)


class Unwrapper:
    """Runs a wrapping count on over its modulus. The first value is taken as it comes.

    Right as long as two readings are less than half a modulus apart.
    """

    __slots__ = ("_count", "_half", "_modulus")

    def __init__(self, modulus: int) -> None:
        self._modulus = modulus
        self._half = modulus // 2
        self._count: int | None = None

    def __call__(self, raw: int) -> int:
        """The running count for a raw reading."""
        if self._count is None:
            self._count = raw
        else:
            half = self._half
            self._count += (raw - self._count + half) % self._modulus - half
        return self._count


@dataclass(frozen=True, slots=True)
class DriveScale:
    """What the drive's numbers are worth at the shaft that the bench calls motor angle.

    `rad_s_per_digit` is signed by the direction, as are the others; `nm_per_digit` is None where
    the drive does not tell its rated torque, `a_per_digit` where it does not tell its current.
    `a_per_torque_digit` is what a digit of torque (0x6077) is in current: both are per mille of a
    rating, and a drive makes its torque of its current. None where it tells one rating only.
    """

    rad_per_count: float
    rad_s_per_digit: float
    nm_per_digit: float | None
    a_per_digit: float | None = None
    a_per_torque_digit: float | None = None


def drive_scale(
    counts_per_revolution: int,
    gear_ratio: float,
    direction: int,
    si_unit_velocity: int,
    *,
    rated_torque_nm: float | None,
    a_per_digit: float | None = None,
    rated_current_a: float | None = None,
) -> DriveScale:
    """Scale factors of one drive; SettingsError for an unknown velocity unit."""
    unit_rad_s = velocity_unit_rad_s(si_unit_velocity, counts_per_revolution)
    rated = rated_torque_nm is not None and rated_current_a is not None
    return DriveScale(
        rad_per_count=direction * 2.0 * math.pi / (counts_per_revolution * gear_ratio),
        rad_s_per_digit=direction * unit_rad_s / gear_ratio,
        nm_per_digit=None if rated_torque_nm is None else direction * rated_torque_nm * 1e-3,
        a_per_digit=None if a_per_digit is None else direction * a_per_digit,
        a_per_torque_digit=direction * (rated_current_a or 0.0) * 1e-3 if rated else None,
    )


def check_ratio(what: str, setting: str, configured: int, numerator: int, denominator: int) -> None:
    """Compare a ratio that the device reports with the configuration's figure.

    Raises SettingsError that shows both.
    """
    if denominator == 0 or Fraction(numerator, denominator) != configured:
        raise SettingsError(
            f"{what} = {numerator} / {denominator}, but the configuration says "
            f"{setting} = {configured}: every angle would be wrong by that. Make them the same: "
            f"correct {setting}, or set the device."
        )
