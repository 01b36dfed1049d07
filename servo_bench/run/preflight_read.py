"""What the drive itself says about an experiment: read by SDO or register, nothing is written."""

import math

import numpy as np

from drivers.canopen.node import Node
from drivers.canopen.profile import Gain
from drivers.canopen.scaling import velocity_unit_rad_s
from drivers.canopen.settings import CanopenSettings
from drivers.canopen.setup import open_drive
from drivers.canopen.units import rated_torque_nm
from drivers.clock import SYSTEM_CLOCK
from drivers.modbus import profile as names
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.setup import Registers
from drivers.modbus.stopping import open_link
from servo_bench.errors import gathered
from servo_bench.excitation.experiment import Experiment, Schedule
from servo_bench.excitation.prediction import predict
from servo_bench.rig import RigConfig
from servo_bench.run.axes import axis_settings
from servo_bench.run.doctor.canopen import opened
from servo_bench.run.finding import Finding, change, note, ok
from servo_bench.run.preflight import judge_heat, judge_quantum

_RAMPS = ((0x6083, "acceleration"), (0x6084, "deceleration"))
_PER_CENT = 0.05
_RPM_RAD_S = math.tau / 60.0


def read_drive(experiment: Experiment, rig: RigConfig) -> list[Finding]:
    """Ask the rig's drive. ConfigError, WireError, DriveError where it cannot be asked."""
    schedule = experiment.schedule()
    settings = axis_settings(rig, experiment.period_s)
    if isinstance(settings, ModbusSettings):
        return _modbus(schedule, rig, settings)
    with opened(settings) as line:
        node = open_drive(line, settings.drive)
        unit_rad_s = _velocity_unit_rad_s(node, settings)
        return [
            judge_quantum(unit_rad_s, schedule, "velocity quantum, as set in the drive"),
            _rated(node, settings, schedule, rig),
            *_speed_limits(node, schedule, unit_rad_s),
            *_ramps(node, settings, schedule, unit_rad_s),
            *_shaping(node, settings),
            *_gains(node, settings, rig),
        ]


def _velocity_unit_rad_s(node: Node, settings: CanopenSettings) -> float:
    drive = settings.drive
    unit = node.read(0x60A9) if node.has(0x60A9) else drive.profile.units.velocity_si_unit
    return velocity_unit_rad_s(unit, drive.counts_per_revolution) / drive.gear_ratio


def _rated(node: Node, settings: CanopenSettings, schedule: Schedule, rig: RigConfig) -> Finding:
    rated_nm = rated_torque_nm(node, settings.drive.profile.units)
    if rated_nm is None:
        return note("unit of 0x6077", f"{node.name} tells no rated torque (0x6076).")
    seen = predict(schedule, rig)
    constant_nm_per_a = rig.nominal.torque_constant_nm_per_a
    peak_nm = seen.peak_current_a * constant_nm_per_a
    text = (
        f"a digit of 0x6077 is {rated_nm * 1e-3:.3g} N m, {100 * rated_nm * 1e-3 / peak_nm:.2g} % "
        f"of the predicted peak of {peak_nm:.3g} N m"
    )
    for index, what in ((0x6072, "torque"), (0x6073, "current")):
        if node.has(index) and node.read(index) * 1e-3 * rated_nm < peak_nm:
            limit = node.read(index)
            return change(
                "torque limit",
                f"{text}; the drive limits its {what} (0x{index:04X}) to {limit} per mille: the "
                "excitation's steps will be cut. Raise it, or lower the amplitude.",
            )
    return judge_heat(text, seen.rms_current_a * constant_nm_per_a, rated_nm)


def _speed_limits(node: Node, schedule: Schedule, unit_rad_s: float) -> list[Finding]:
    findings = []
    for index, worth_rad_s in ((0x607F, unit_rad_s), (0x6080, _RPM_RAD_S)):
        if not node.has(index):
            continue
        limit_rad_s = node.read(index) * worth_rad_s
        text = f"0x{index:04X} allows {math.degrees(limit_rad_s):.4g} deg/s"
        if limit_rad_s < schedule.peak_velocity_rad_s:
            needed = math.degrees(schedule.peak_velocity_rad_s)
            text = f"{text}, {needed:.4g} are commanded: raise it."
            findings.append(change("speed limit", text))
        else:
            findings.append(ok("speed limit", f"{text}."))
    return findings


def _ramps(
    node: Node, settings: CanopenSettings, schedule: Schedule, unit_rad_s: float
) -> list[Finding]:
    if settings.drive.mode != "pv":
        return []
    step_rad_s = float(np.abs(np.diff(schedule.velocity_rad_s, prepend=0.0)).max())
    findings = []
    for index, what in _RAMPS:
        if not node.has(index):
            continue
        slope = node.read(index) * unit_rad_s
        takes_s = step_rad_s / slope if slope else math.inf
        text = f"{what} ramp (0x{index:04X}): the largest step takes {takes_s * 1e3:.3g} ms"
        if takes_s > _PER_CENT * settings.period_s:
            text = f"{text} of a period of {settings.period_s * 1e3:g} ms: raise it."
            findings.append(change("ramps", text))
        else:
            findings.append(ok("ramps", f"{text}."))
    return findings


def _shaping(node: Node, settings: CanopenSettings) -> list[Finding]:
    findings = []
    for it in settings.drive.profile.shaping:
        label = f"0x{it.object[0]:04X}:{it.object[1]}"
        if not node.has(*it.object):
            findings.append(note("shaping", f"{it.what}: the EDS has no {label}."))
            continue
        value = node.read(*it.object)
        text = f"{it.what} ({label}) = {value}"
        if it.neutral is None:
            findings.append(note("shaping", f"{text}: it is part of what will be identified."))
        elif value != it.neutral:
            text = f"{text}: alters the excitation; {it.neutral} does not."
            findings.append(change("shaping", text))
        else:
            findings.append(ok("shaping", f"{text}: off."))
    return findings


def _gains(node: Node, settings: CanopenSettings, rig: RigConfig) -> list[Finding]:
    gains, nominal = settings.drive.profile.gains, rig.nominal
    findings = []
    for name, gain, configured, unit in (
        (
            "K_P",
            gains.proportional_a_s_per_rad,
            nominal.proportional_gain_a_s_per_rad,
            "A s/rad",
        ),
        ("K_I", gains.integral_a_per_rad, nominal.integral_gain_a_per_rad, "A/rad"),
    ):
        if gain is not None and node.has(*gain.object):
            findings.append(_gain(name, node, gain, configured, unit))
    return findings


def _gain(name: str, node: Node, gain: Gain, configured: float, unit: str) -> Finding:
    value = node.read(*gain.object) * gain.per_digit
    text = f"{name} is {value:.4g} {unit} in the drive, {configured:.4g} in [nominal]"
    if not math.isclose(value, configured, rel_tol=_PER_CENT):
        return change(name, f"{text}: make [nominal] the drive's, or fit it.")
    return ok(name, f"{text}.")


def _modbus(schedule: Schedule, rig: RigConfig, settings: ModbusSettings) -> list[Finding]:
    with gathered():
        link = open_link(settings, SYSTEM_CLOCK)
        try:
            registers = Registers(link, settings, SYSTEM_CLOCK)
            item = settings.drive.profile.items.get(names.RATED_TORQUE)
            if item is None:
                return [note("rated torque", "this register map does not tell it.")]
            rated_nm = float(registers.read(names.RATED_TORQUE)) * item.scale
        finally:
            link.close()
    seen = predict(schedule, rig)
    rms_nm = seen.rms_current_a * rig.nominal.torque_constant_nm_per_a
    return [judge_heat(f"RMS torque {rms_nm:.3g} N m", rms_nm, rated_nm)]
