"""Digits in registers, SI in the bench. Signs follow the direction, as in `drivers.canopen`.

angle     rad    = direction · counts · 2π / (counts per revolution · gear ratio)
velocity  rad/s  = direction · digits · scale · unit / gear ratio
torque    N m    = direction · digits · scale             or per mille of the rated torque
current   A      = direction · digits · scale             or per mille of the rated current
"""

import math
from dataclasses import dataclass

from drivers.modbus import profile as names
from drivers.modbus.registers import Item
from drivers.modbus.settings import ModbusDriveSettings


@dataclass(frozen=True, slots=True)
class Scale:
    """What digits are worth; None where the drive does not tell."""

    command_rad_s: float
    rad_per_count: float
    rad_per_load_count: float
    velocity_rad_s: float | None
    torque_nm: float | None
    current_a: float | None
    time_us: float | None
    temperature_c: float | None = None


def scale_of(
    drive: ModbusDriveSettings, *, rated_torque_nm: float | None, rated_current_a: float | None
) -> Scale:
    """The factors of one drive."""
    items = drive.profile.items
    load = drive.load
    velocity, time = items.get(names.VELOCITY), items.get(names.TIME)
    temperature = items.get(names.TEMPERATURE)
    return Scale(
        command_rad_s=_velocity(items[names.TARGET], drive),
        rad_per_count=_per_count(drive) / drive.gear_ratio,
        rad_per_load_count=load.direction * math.tau / load.counts_per_revolution if load else 0.0,
        velocity_rad_s=_velocity(velocity, drive) if velocity else None,
        torque_nm=_rated(items.get(names.TORQUE), drive.direction, rated_torque_nm),
        current_a=_rated(items.get(names.CURRENT), drive.direction, rated_current_a),
        time_us=time.scale if time else None,
        temperature_c=temperature.scale if temperature else None,
    )


def _per_count(drive: ModbusDriveSettings) -> float:
    return drive.direction * math.tau / drive.counts_per_revolution


def _velocity(item: Item, drive: ModbusDriveSettings) -> float:
    unit_rad_s = {
        "count/s": math.tau / drive.counts_per_revolution,
        "rpm": math.tau / 60.0,
        "rad/s": 1.0,
    }[item.unit]
    return drive.direction * item.scale * unit_rad_s / drive.gear_ratio


def _rated(item: Item | None, direction: int, rated: float | None) -> float | None:
    if item is None:
        return None
    if item.unit != "per mille rated":
        return direction * item.scale
    return None if rated is None else direction * item.scale * rated * 1e-3
