"""The Modbus line and its drive, read; nothing is written but what its profile must read by."""

from statistics import median

from drivers.clock import SYSTEM_CLOCK
from drivers.errors import DriverError
from drivers.modbus.budget import shortest_period
from drivers.modbus.link import Link
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.setup import Registers, check_identity
from drivers.modbus.stopping import open_link
from servo_bench.errors import gathered
from servo_bench.run.finding import Finding, change, note, ok, stop

READS = 50
SLOW = 0.8
"""A line that takes more of a period than this leaves nothing for a late answer."""


def examine(settings: ModbusSettings) -> list[Finding]:
    """Line, identity, state, round trip, own stop. WireError where nobody answers."""
    with gathered():
        link = open_link(settings, SYSTEM_CLOCK)
        try:
            return _examined(link, settings)
        finally:
            link.close()


def _examined(link: Link, settings: ModbusSettings) -> list[Finding]:
    registers = Registers(link, settings, SYSTEM_CLOCK)
    profile = settings.drive.profile
    findings = [_identity(registers, settings)]
    if profile.prepare:
        until_ns = SYSTEM_CLOCK.now_ns() + round(settings.drive.enable_timeout_s * 1e9)
        registers.follow(profile.prepare, until_ns)
        findings.append(note("prepared", "what its profile writes before it can be read."))
    findings += [_state(registers), _round_trip(registers, settings), _own_stop(settings)]
    return findings


def _identity(registers: Registers, settings: ModbusSettings) -> Finding:
    try:
        check_identity(registers, settings)
    except DriverError as error:
        return stop("drive's identity", str(error))
    known = ", ".join(settings.drive.profile.identity) or "nothing to know it by"
    return ok("drive's identity", f"{settings.drive.profile.title} ({known}).")


def _state(registers: Registers) -> Finding:
    status = registers.status()
    bits = registers.profile.bits
    text = f"statusword 0x{status:04X}"
    if bits.enabled.hold(status):
        return stop("state", f"{text}: it is enabled, somebody drives it. Stop them first.")
    if bits.fault.hold(status):
        error = registers.error_text()
        return change("state", f"{text}, in fault{error}: a run begins with one reset.")
    return ok("state", f"{text}: off, no fault.")


def _round_trip(registers: Registers, settings: ModbusSettings) -> Finding:
    took_s = []
    for _ in range(READS):
        begun_ns = SYSTEM_CLOCK.now_ns()
        registers.state()
        took_s.append((SYSTEM_CLOCK.now_ns() - begun_ns) * 1e-9)
    budget = shortest_period(settings.drive.profile, settings.line, settings.plan)
    text = (
        f"reading takes {median(took_s) * 1e3:.2f} ms at the median, {max(took_s) * 1e3:.2f} ms at "
        f"the worst of {READS}; a period is {settings.period_s * 1e3:g} ms; the sum: {budget}; "
        f"{registers.link.damaged} damaged frames"
    )
    if registers.link.damaged:
        return change("line", f"{text}: check termination, shield, and parity.")
    if median(took_s) > SLOW * settings.period_s:
        return change("line", f"{text}: too slow. Lengthen the period, or raise the speed.")
    return ok("line", f"{text}.")


def _own_stop(settings: ModbusSettings) -> Finding:
    own_stop_s = settings.own_stop_s
    if own_stop_s is None:
        text = "it does not stop by itself; acknowledged. Keep the emergency stop at hand."
        return change("own stop", text)
    return ok("own stop", f"it stops by itself {own_stop_s:g} s after its master's last word.")
