"""What an experiment will do to a rig, said before anything is enabled; from files alone.

What it will do is foretold by the rig's own model (`excitation.prediction`).

    thermal margin  1 - (I_rms / I_rated)^2        I_rated = rated torque / K_T
"""

import math
from collections.abc import Callable

import numpy as np

from drivers.canopen.budget import BIT_RATES, FULL, REMEDY, bus_budget
from drivers.canopen.line import known_interface
from drivers.canopen.profile import DriveProfile
from drivers.canopen.scaling import velocity_unit_rad_s
from drivers.canopen.settings import CanopenSettings, bit_rate
from drivers.canopen.stopline import SHARED_BUSES
from drivers.counter.settings import CounterSettings, sum_of
from drivers.modbus import profile as names
from drivers.modbus.budget import shortest_period
from drivers.modbus.scaling import scale_of
from drivers.modbus.settings import ModbusSettings
from servo_bench.devices import ModbusDriveConfig
from servo_bench.errors import BenchError, gathered
from servo_bench.excitation.experiment import Experiment, Schedule
from servo_bench.excitation.prediction import Prediction, predict
from servo_bench.rig import RigConfig
from servo_bench.run.axes import axis_settings
from servo_bench.run.finding import Finding, change, note, ok, stop
from servo_bench.run.limits import check_schedule
from servo_bench.run.session import check_memory

COARSE = 0.01
"""A velocity quantum above this share of the command's amplitude is worth a change."""


def preflight(experiment: Experiment, rig: RigConfig) -> list[Finding]:
    """Everything that files can tell. A check that cannot be made is a finding itself."""
    schedule = experiment.schedule()
    settings: CanopenSettings | ModbusSettings | None = None
    findings: list[Finding] = []
    try:
        settings = axis_settings(rig, experiment.period_s)
    except BenchError as error:
        findings.append(stop("period and line", str(error)))
    for subject, check in (
        ("memory", lambda: _memory(experiment)),
        ("limits", lambda: _limits(schedule, rig)),
        ("motion and current", lambda: _motion(schedule, rig)),
    ):
        findings += _attempt(subject, check)
    if settings is not None and rig.limits.drive_temperature_c is not None:
        findings.append(_temperature(settings, rig.limits.drive_temperature_c))
    if isinstance(settings, CanopenSettings):
        findings += _attempt("bus", lambda: _interface(settings))
        findings += _attempt("drive", lambda: _canopen(schedule, settings))
    elif isinstance(settings, ModbusSettings):
        findings += _attempt("drive", lambda: _modbus(schedule, settings))
    if settings is not None:
        findings += _counter(rig.counter_settings(experiment.period_s))
    return findings


def _attempt(subject: str, check: Callable[[], list[Finding]]) -> list[Finding]:
    try:
        with gathered():
            return check()
    except BenchError as error:
        return [stop(subject, str(error))]


def _temperature(settings: CanopenSettings | ModbusSettings, limit_c: float) -> Finding:
    """Whether anybody tells the temperature that has a limit."""
    profile = settings.drive.profile
    owner = None if isinstance(settings, ModbusSettings) else settings.bus.get("interface")
    if owner is not None and owner not in SHARED_BUSES:
        return change(
            "temperature",
            f"limits.drive_temperature_c = {limit_c:g} watches nothing: it is asked over a second "
            f"connection to the bus, and {owner} has one owner. Use one of "
            f"{', '.join(sorted(SHARED_BUSES))}, or take the limit out.",
        )
    if isinstance(settings, ModbusSettings):
        block = [name for read in settings.drive.profile.cycle.read for name in read]
        told = names.TEMPERATURE in block
    else:
        told = settings.drive.profile.temperature is not None
    if told:
        return ok("temperature", f"the drive tells it; a run trips above {limit_c:g} °C.")
    return change(
        "temperature",
        f"limits.drive_temperature_c = {limit_c:g} watches nothing: the profile of {profile.title} "
        "does not say where the drive tells it. Complete the profile, or take the limit out.",
    )


def _memory(experiment: Experiment) -> list[Finding]:
    check_memory(experiment)
    return []


def _limits(schedule: Schedule, rig: RigConfig) -> list[Finding]:
    check_schedule(schedule, rig.limits)
    return [
        ok(
            "limits",
            f"commanded: {math.degrees(schedule.peak_velocity_rad_s):.4g} of "
            f"{math.degrees(rig.limits.velocity_rad_s):.4g} deg/s, travel "
            f"{math.degrees(schedule.peak_travel_rad):.4g} of "
            f"{math.degrees(rig.limits.travel_rad):.4g} deg, {schedule.duration_s:.4g} s.",
        )
    ]


def _motion(schedule: Schedule, rig: RigConfig) -> list[Finding]:
    seen = predict(schedule, rig)
    findings = []
    for what, got_rad, allowed_rad, unit in (
        ("motor travel", seen.motor_travel_rad, rig.limits.travel_rad, "deg"),
        ("load travel", seen.load_travel_rad, rig.limits.travel_rad, "deg"),
        ("motor velocity", seen.peak_velocity_rad_s, rig.limits.velocity_rad_s, "deg/s"),
        ("load velocity", seen.load_velocity_rad_s, rig.limits.velocity_rad_s, "deg/s"),
    ):
        text = (
            f"the model reaches {math.degrees(got_rad):.4g} {unit}, the limit is "
            f"{math.degrees(allowed_rad):.4g} {unit}"
        )
        over = got_rad > allowed_rad
        remedy = ": the run would trip. Lower the amplitude, or raise the limit."
        findings.append(stop(what, text + remedy) if over else ok(what, f"{text}."))
    return findings + _current(seen, rig)


def rated_torque_nm(rig: RigConfig) -> float | None:
    """What the rig file knows of it; None where only the drive can tell."""
    if isinstance(rig.drive, ModbusDriveConfig) and rig.drive.rated_torque_nm is not None:
        return rig.drive.rated_torque_nm
    return rig.simulated.rated_torque_nm if rig.simulated else None


def _current(seen: Prediction, rig: RigConfig) -> list[Finding]:
    constant_nm_per_a = rig.nominal.torque_constant_nm_per_a
    text = (
        f"peak {seen.peak_current_a:.3g} A ({seen.peak_current_a * constant_nm_per_a:.3g} N m, in "
        f"the first instant of a step), RMS {seen.rms_current_a:.3g} A"
    )
    limit_nm = rig.limits.torque_nm
    if limit_nm is not None and seen.peak_current_a * constant_nm_per_a > limit_nm:
        return [stop("current", f"{text}; limits.torque_nm is {limit_nm:g} N m: it would trip.")]
    rated_nm = rated_torque_nm(rig)
    if rated_nm is None:
        more = "the rated torque (0x6076) is the drive's to tell: preflight --read asks it."
        return [note("current", f"{text}; thermal margin unknown: {more}")]
    return [judge_heat(text, seen.rms_current_a * constant_nm_per_a, rated_nm)]


def judge_heat(text: str, rms_torque_nm: float, rated_nm: float) -> Finding:
    """The thermal margin against the rated torque."""
    margin = 1.0 - (rms_torque_nm / rated_nm) ** 2
    text = f"{text}; rated {rated_nm:.3g} N m: thermal margin {100 * margin:.0f} %"
    if margin <= 0.0:
        return stop("current", f"{text}: the motor overheats. Lower the amplitude.")
    if margin < 0.3:
        return change("current", f"{text}: warm. Lower the amplitude, or pause between runs.")
    return ok("current", f"{text}.")


def _amplitude_rad_s(schedule: Schedule) -> float:
    """A small velocity of those that are commanded, beside none: a tenth are no larger. The very
    smallest of levels drawn at random says nothing."""
    moving = np.abs(schedule.velocity_rad_s[schedule.velocity_rad_s != 0.0])
    return float(np.quantile(moving, 0.1, method="lower")) if moving.size else math.inf


def judge_quantum(quantum_rad_s: float, schedule: Schedule, subject: str) -> Finding:
    """One digit of velocity against the excitation's amplitude."""
    amplitude_rad_s = _amplitude_rad_s(schedule)
    share = quantum_rad_s / amplitude_rad_s
    text = (
        f"one digit is {quantum_rad_s * 60 / math.tau:.3g} rpm, {100 * share:.2g} % of V = "
        f"{math.degrees(amplitude_rad_s):.4g} deg/s"
    )
    if share > COARSE:
        return change(subject, f"{text}: set a finer unit (0x60A9), or raise the amplitude.")
    return ok(subject, f"{text}.")


def _interface(settings: CanopenSettings) -> list[Finding]:
    known_interface(settings.bus)
    return []


def _canopen(schedule: Schedule, settings: CanopenSettings) -> list[Finding]:
    drive = settings.drive
    units = drive.profile.units
    unit = units.set_velocity_si_unit or units.velocity_si_unit
    with gathered():
        quantum_rad_s = velocity_unit_rad_s(unit, drive.counts_per_revolution) / drive.gear_ratio
    return [
        judge_quantum(quantum_rad_s, schedule, "velocity quantum"),
        note(
            "unit of 0x6077",
            "per mille of the rated torque (0x6076, a digit of which is "
            f"{units.rated_torque_unit_nm:g} N m by the profile).",
        ),
        _mode(drive.mode, drive.profile),
        *(
            note("shaping", f"0x{it.object[0]:04X}:{it.object[1]}, {it.what}: --read reads it.")
            for it in drive.profile.shaping
        ),
        _gains(drive.profile),
        *_bus(settings),
    ]


def _mode(mode: str, profile: DriveProfile) -> Finding:
    delay = profile.timing.command_delay_cycles
    late = f"; a command acts {delay} SYNC(s) late" if delay else ""
    if mode == "pv":
        return change(
            "ramps",
            "profile velocity: the ramps 0x6083 and 0x6084 shape every step. Set them far above "
            f"2 V / period, or take mode csv where the drive has it{late}.",
        )
    return ok("ramps", f"cyclic synchronous velocity: no ramps{late}.")


def _gains(profile: DriveProfile) -> Finding:
    gains = (profile.gains.proportional_a_s_per_rad, profile.gains.integral_a_per_rad)
    if None in gains:
        return note(
            "K_P, K_I",
            "how the vendor's digits convert is unknown: will be fitted (servo-bench fit).",
        )
    parts = [
        f"{name} = 0x{gain.object[0]:04X}:{gain.object[1]} x {gain.per_digit:g} {unit}"
        for name, gain, unit in zip(("K_P", "K_I"), gains, ("A s/rad", "A/rad"), strict=True)
        if gain is not None
    ]
    return note("K_P, K_I", f"{', '.join(parts)}: --read compares them with [nominal].")


def _bus(settings: CanopenSettings) -> list[Finding]:
    budget = bus_budget(settings)
    configured = bit_rate(settings.bus)
    rates = (configured,) if configured else BIT_RATES
    loads = ", ".join(f"{100 * budget.load(rate):.0f} % at {rate // 1000} kbit/s" for rate in rates)
    text = f"{budget} in {settings.period_s * 1e3:g} ms, SYNC's period: {loads}"
    if not budget.holds(max(rates)):
        return [stop("bus load", f"{text}: it does not hold. {REMEDY}")]
    if configured and budget.load(int(configured)) > FULL:
        return [change("bus load", f"{text}: raise the bit rate, or lengthen the period.")]
    return [ok("bus load", f"{text}.")]


def _counter(settings: CounterSettings | None) -> list[Finding]:
    """The load's counter on its serial line: the sum, and when its sample is."""
    if settings is None:
        return []
    text = (
        f"{sum_of(settings.profile, settings.line)}; the load's angle is taken "
        f"{settings.sampled_after_s * 1e3:.2f} ms after the ask (recorded: load_sampled_s)"
    )
    if settings.give_up_s > settings.period_s and not settings.profile.is_numbered:
        return [
            change(
                "load counter",
                f"{text}. Its longest answer takes {settings.give_up_s * 1e3:.2f} ms, more than a "
                "period: a lost one costs two slots or more. Lengthen the period, or raise the "
                "speed.",
            )
        ]
    return [ok("load counter", f"{text}.")]


def _modbus(schedule: Schedule, settings: ModbusSettings) -> list[Finding]:
    drive = settings.drive
    budget = shortest_period(drive.profile, settings.line, settings.plan)
    scale = scale_of(drive, rated_torque_nm=drive.rated_torque_nm, rated_current_a=None)
    torque = drive.profile.items.get(names.TORQUE)
    findings = [
        judge_quantum(abs(scale.command_rad_s), schedule, "velocity quantum"),
        ok("wire budget", f"{budget} of {settings.period_s * 1e3:g} ms."),
        note("ramps", "this register map does not tell: see the drive's ramps and filters."),
        note("K_P, K_I", "how the vendor's digits convert is unknown: will be fitted."),
    ]
    if torque is not None:
        findings.append(note("unit of the torque", f"{torque.scale:g} {torque.unit} a digit."))
    return findings
