"""What a column can be (its role), and in which units it may be written.

A role fixes the channel's name and its quantity; a unit that is none of that quantity is refused.
Inside, everything is SI, but for temperatures in degrees Celsius:

    value_si = factor * value + shift
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from servo_bench.errors import ConfigError


class Role(NamedTuple):
    """`base + suffix` is the channel's name; a map may give another base."""

    base: str
    suffix: str
    quantity: str
    meaning: str


class Unit(NamedTuple):
    """value_si = factor * value + shift; `per_rev` divides by the map's counts_per_rev too."""

    factor: float
    shift: float = 0.0
    per_rev: bool = False


TURN = 2.0 * math.pi

UNITS: Mapping[str, Mapping[str, Unit]] = {
    "time": {"s": Unit(1.0), "ms": Unit(1e-3), "us": Unit(1e-6), "ns": Unit(1e-9)},
    "angle": {
        "rad": Unit(1.0),
        "mrad": Unit(1e-3),
        "deg": Unit(TURN / 360.0),
        "arcmin": Unit(TURN / 21600.0),
        "rev": Unit(TURN),
        "counts": Unit(TURN, per_rev=True),
    },
    "angular velocity": {
        "rad/s": Unit(1.0),
        "deg/s": Unit(TURN / 360.0),
        "rev/s": Unit(TURN),
        "rpm": Unit(TURN / 60.0),
        "counts/s": Unit(TURN, per_rev=True),
    },
    "current": {"A": Unit(1.0), "mA": Unit(1e-3)},
    "torque": {"Nm": Unit(1.0), "mNm": Unit(1e-3), "Ncm": Unit(1e-2)},
    "voltage": {"V": Unit(1.0), "mV": Unit(1e-3)},
    "temperature": {
        "degC": Unit(1.0),
        "K": Unit(1.0, -273.15),
        "degF": Unit(5.0 / 9.0, -160.0 / 9.0),
    },
    "whole number": {"1": Unit(1.0)},
}

INTEGERS = "whole number"

ROLES: Mapping[str, Role] = {
    "time": Role("t", "_s", "time", "when the row was sampled"),
    "velocity_command": Role("velocity_command", "_rad_s", "angular velocity", "to the drive"),
    "position_command": Role("position_command", "_rad", "angle", "to the drive"),
    "current_command": Role("current_command", "_a", "current", "to the current loop"),
    "torque_command": Role("torque_command", "_nm", "torque", "to the drive"),
    "current": Role("current", "_a", "current", "that makes torque (I_q), measured"),
    "motor_torque": Role("motor_torque", "_nm", "torque", "the drive's own figure"),
    "torque": Role("torque", "_nm", "torque", "from the drive or a sensor, at the given axis"),
    "voltage": Role("voltage", "_v", "voltage", "at the motor"),
    "supply_voltage": Role("supply_voltage", "_v", "voltage", "of the drive"),
    "motor_position": Role("motor_position", "_rad", "angle", "before the transmission"),
    "motor_velocity": Role("motor_velocity", "_rad_s", "angular velocity", "as it was given"),
    "load_position": Role("load_angle", "_rad", "angle", "behind the transmission"),
    "load_velocity": Role("load_velocity", "_rad_s", "angular velocity", "as it was given"),
    "temperature": Role("temperature", "_c", "temperature", "of motor or drive"),
    "motor_sampled": Role("motor_sampled", "_s", "time", "after the row's time, as the next two"),
    "current_sampled": Role("current_sampled", "_s", "time", "below zero where it comes late"),
    "load_sampled": Role("load_sampled", "_s", "time", "likewise"),
    "current_filtered": Role("current_filtered", "_s", "time", "of the low pass it went through"),
    "flag": Role("", "", INTEGERS, "a state or a mark; the map names it"),
    "slot": Role("slot", "", INTEGERS, "which period, counted from 0"),
    "phase": Role("phase", "", INTEGERS, "0 standstill, 1 lead-in, 2 identification, 3 validation"),
    "chip": Role("chip", "", INTEGERS, "place in its sequence, -1 outside"),
}


def role_of(name: str, where: str) -> Role:
    """The role called `name`; ConfigError with all of them where there is none."""
    if name not in ROLES:
        raise ConfigError(f"{where}: there is no role {name!r}. Give one of {', '.join(ROLES)}.")
    return ROLES[name]


def unit_of(role_name: str, unit: str, counts_per_rev: float | None, where: str) -> Unit:
    """The unit of a column in that role, counts resolved; ConfigError where it does not fit."""
    quantity = role_of(role_name, where).quantity
    allowed = UNITS[quantity]
    if unit not in allowed:
        raise ConfigError(
            f"{where}: the role {role_name} is {_article(quantity)} {quantity}, and its unit is "
            f"{unit!r}. Give one of {', '.join(allowed)}, or another role."
        )
    found = allowed[unit]
    if found.per_rev != (counts_per_rev is not None):
        raise ConfigError(
            f"{where}: counts_per_rev is {counts_per_rev} with the unit {unit!r}. Give the counts "
            "of one revolution with the units counts and counts/s, and with no other."
        )
    return Unit(found.factor / counts_per_rev) if counts_per_rev else found


def _article(quantity: str) -> str:
    return "an" if quantity[0] in "aeiou" else "a"
