"""What a drive's digits are worth: asked of the drive where it tells, of its profile where not."""

from collections.abc import Callable

from drivers.canopen.node import Node
from drivers.canopen.profile import TORQUE, Units
from drivers.canopen.scaling import DriveScale, check_ratio, drive_scale
from drivers.canopen.settings import DriveSettings

Note = Callable[[str, str], None]

_NO_FEED_CONSTANT = (1, 1)
"""0x6092 as drives ship it that count increments: whole revolutions as a unit would be useless."""


def read_drive_scale(node: Node, drive: DriveSettings, note: Note) -> DriveScale:
    """Scale factors, the ratios checked. SettingsError where the drive contradicts the settings."""
    units = drive.profile.units
    check_ratios(node, drive)
    torque_nm = rated_torque_nm(node, units)
    if torque_nm is None:
        note("no torque", f"{node.name} tells no rated torque (0x6076) or no torque (0x6077).")
    scale = drive_scale(
        drive.counts_per_revolution,
        drive.gear_ratio,
        drive.direction,
        _velocity_unit(node, units, note),
        rated_torque_nm=torque_nm,
        a_per_digit=_a_per_digit(node, units),
        rated_current_a=_rated_current_a(node),
    )
    if scale.a_per_digit is None and node.mappable(*units.current.object):
        note(
            "no motor current",
            f"{node.name} tells a current but not what it is per mille of (0x6075): "
            "motor_current_a stays empty. Give a_per_digit in [units.current] of a profile.",
        )
    return scale


def check_ratios(node: Node, drive: DriveSettings) -> None:
    """Raise SettingsError where the drive's own ratios contradict the settings."""
    counts = drive.counts_per_revolution
    for index, what, setting, wanted in (
        (0x608F, "encoder increments / motor revolutions", "drive.counts_per_revolution", counts),
        (0x6092, "feed / shaft revolutions", "drive.counts_per_revolution", counts),
        (0x6091, "motor / shaft revolutions; drive.gear_ratio belongs to the bench", "ratio", 1),
    ):
        checked = (index, 0) in drive.profile.units.ratios
        if checked and node.has(index, 1) and node.has(index, 2):
            label = f"{node.name}: 0x{index:04X} ({what})"
            ratio = node.read(index, 1), node.read(index, 2)
            if index != 0x6092 or ratio != _NO_FEED_CONSTANT:
                check_ratio(label, setting, wanted, *ratio)


def _velocity_unit(node: Node, units: Units, note: Note) -> int:
    if node.has(0x60A9):
        if units.set_velocity_si_unit is not None and node.writable(0x60A9):
            advice = "Take another set_velocity_si_unit in the drive profile."
            node.configure(0x60A9, 0, units.set_velocity_si_unit, advice)
        return node.read(0x60A9)
    note(
        "velocity unit assumed",
        f"{node.name} has no 0x60A9: its velocities are taken as 0x{units.velocity_si_unit:08X} "
        "(0x00B50300 is increments/s, 0x00B44700 rpm).",
    )
    return units.velocity_si_unit


def rated_torque_nm(node: Node, units: Units) -> float | None:
    """What 0x6077 is per mille of; None where the drive does not tell."""
    if not (node.has(0x6076) and node.mappable(*TORQUE)):
        return None
    return node.read(0x6076) * units.rated_torque_unit_nm or None


def _a_per_digit(node: Node, units: Units) -> float | None:
    if not node.mappable(*units.current.object):
        return None
    if units.current.a_per_digit is not None:
        return units.current.a_per_digit
    rated_a = _rated_current_a(node)
    return None if rated_a is None else rated_a * 1e-3


def _rated_current_a(node: Node) -> float | None:
    """What 0x6078 is per mille of; None where the drive does not tell."""
    return (node.read(0x6075) * 1e-3 or None) if node.has(0x6075) else None
