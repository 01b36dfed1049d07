"""The CANopen bus and its nodes, asked and listened to; nothing is written."""

import json
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from drivers.canopen import cia402
from drivers.canopen.budget import BIT_RATES, FULL, HOLDS, REMEDY, bus_budget, frame_bits
from drivers.canopen.guarding import LIFE_TIME_FACTOR, carries_remote_frames
from drivers.canopen.line import Line, open_bus
from drivers.canopen.listening import refuse_another_master
from drivers.canopen.node import Node
from drivers.canopen.scaling import check_ratio
from drivers.canopen.scan import Found, find_nodes
from drivers.canopen.settings import CanopenSettings, EncoderSettings, bit_rate
from drivers.canopen.setup import identify, open_drive, open_encoder
from drivers.canopen.units import check_ratios, rated_torque_nm
from drivers.errors import DriverError
from servo_bench.errors import BenchError, gathered
from servo_bench.run.finding import Finding, change, note, ok, stop

LISTEN_S = 0.25


@contextmanager
def opened(settings: CanopenSettings) -> Iterator[Line]:
    """The bus, while nobody else is master on it; WireError or ConfigError in words."""
    with gathered():
        line = Line(open_bus(settings.bus))
    try:
        with gathered():
            refuse_another_master(line, settings)
            yield line
    finally:
        line.close()


def examine(settings: CanopenSettings) -> list[Finding]:
    """Bus load, nodes, identities, ratios, states, error counters. Errors as `opened`."""
    with opened(settings) as line:
        findings = [_load(line, settings), *_adapter(settings)]
        nodes = find_nodes(line)
        findings.append(note("nodes", "; ".join(map(str, nodes)) or "nobody answers."))
        if _is_there(nodes, settings.drive.node.node_id, "drive", findings):
            drive = open_drive(line, settings.drive)
            findings += _drive(drive, settings)
        encoder = settings.encoder
        if encoder and _is_there(nodes, encoder.node.node_id, "encoder", findings):
            node = open_encoder(line, encoder, settings.drive.sdo_timeout_s)
            findings += _encoder(node, encoder)
        return findings


def _load(line: Line, settings: CanopenSettings) -> Finding:
    """What others already send, and what the period will add."""
    bits = 0

    def count() -> bool:
        nonlocal bits
        frame = line.read(0.01)
        bits += frame_bits(frame.dlc) if frame else 0
        return line.clock.now_ns() > until_ns

    until_ns = line.clock.now_ns() + round(LISTEN_S * 1e9)
    while not count():
        pass
    budget = bus_budget(settings)
    configured = bit_rate(settings.bus)
    rates = (configured,) if configured else BIT_RATES
    loads = [budget.load(rate) + bits / LISTEN_S / rate for rate in rates]
    text = ", ".join(
        f"{100 * load:.0f} % at {rate // 1000} kbit/s"
        for load, rate in zip(loads, rates, strict=True)
    )
    text = f"SYNC every {settings.period_s * 1e3:g} ms and what is on the bus already: {text}"
    if min(loads) > HOLDS:
        return stop("bus load", f"{text}: it does not hold. {REMEDY}")
    if configured and loads[0] > FULL:
        return change("bus load", f"{text}: raise the bit rate, or lengthen the period.")
    return ok("bus load", f"{text}.")


def _adapter(settings: CanopenSettings) -> list[Finding]:
    """The kernel's own counters, where the adapter is the kernel's."""
    interface, channel = settings.bus.get("interface"), str(settings.bus.get("channel", ""))
    if interface != "socketcan":
        return [note("error counters", f"{interface} hands out none.")]
    command = ["ip", "-details", "-statistics", "-json", "link", "show", channel]
    try:
        told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=5.0)
    except (OSError, subprocess.SubprocessError) as error:
        return [note("error counters", f"cannot be read with `ip`: {error}.")]
    return judge_link(told.stdout, channel)


def judge_link(told: str, channel: str) -> list[Finding]:
    """What `ip -details -statistics -json link show` says of a CAN interface."""
    try:
        (link,) = json.loads(told)
        info = link.get("linkinfo", {})
        data, counts = info.get("info_data", {}), info.get("info_xstats", {})
    except (ValueError, AttributeError) as error:
        return [note("error counters", f"`ip` said something else than expected: {error}.")]
    state = data.get("state", "unknown")
    errors = {name: value for name, value in counts.items() if value}
    text = f"{channel} is {state}; " + (
        ", ".join(f"{name} {value}" for name, value in errors.items()) or "no errors counted"
    )
    findings = [ok("error counters", f"{text}.")]
    if state != "ERROR-ACTIVE" and data:
        remedy = "Check both 120 ohm terminators, the bit rate of every node, and the cable."
        findings = [stop("error counters", f"{text}. {remedy}")]
    elif errors:
        findings = [change("error counters", f"{text}: check termination and cable.")]
    if data and not data.get("restart_ms"):
        findings.append(
            change(
                "restart",
                f"{channel} does not come back from bus-off: `ip link set {channel} type can "
                "restart-ms 100`.",
            )
        )
    return findings


def _is_there(nodes: list[Found], node_id: int, name: str, findings: list[Finding]) -> bool:
    if any(node.node_id == node_id for node in nodes):
        return True
    others = ", ".join(str(node.node_id) for node in nodes) or "nobody"
    findings.append(
        stop(
            name,
            f"no node {node_id} on this bus; there: {others}. Correct {name}.node_id, or check its "
            "supply, bit rate, and cable.",
        )
    )
    return False


def _checked(subject: str, check: Callable[[], None], good: str) -> Finding:
    try:
        check()
    except DriverError as error:
        return stop(subject, str(error))
    return ok(subject, good)


def _drive(node: Node, settings: CanopenSettings) -> list[Finding]:
    drive = settings.drive
    counts = drive.counts_per_revolution
    findings = [
        _checked(
            "drive's identity",
            lambda: identify(node, drive.node, drive.profile.vendor_id),
            f"{node.name} is what the rig file says ({drive.profile.title}).",
        ),
        _checked(
            "drive's ratios",
            lambda: check_ratios(node, drive),
            f"its scaling objects agree with {counts} counts in a revolution, as far as it has "
            "them: a slow move (--move) tells the truth.",
        ),
    ]
    try:
        findings += [_state(node), *_errors(node), _watchdog(node, settings)]
    except DriverError as error:
        findings.append(stop("drive", str(error)))
    return findings


def _state(node: Node) -> Finding:
    statusword = node.read(0x6041)
    text = f"{node.name}: {cia402.describe_statusword(statusword)}"
    state = cia402.decode_state(statusword)
    if state == cia402.State.FAULT:
        code = node.read(0x603F) if node.has(0x603F) else 0
        words = f"{cia402.describe_error_code(code)}: {cia402.remedy(code)}"
        return change("state", f"{text}, error code {words}. A run begins with one fault reset.")
    if state in cia402.POWERED:
        return stop("state", f"{text}: somebody has enabled it. Stop them first.")
    if not statusword & cia402.VOLTAGE_ENABLED:
        return change("state", f"{text}. Switch on the DC link before a run.")
    return ok("state", f"{text}.")


def _errors(node: Node) -> list[Finding]:
    register = node.read(0x1001) if node.has(0x1001) else 0
    if not register:
        return []
    return [note("error register", f"{node.name}: 0x1001 = 0x{register:02X}.")]


def _watchdog(node: Node, settings: CanopenSettings) -> Finding:
    drive = settings.drive
    kind = drive.profile.stopping.watchdog
    address = {
        "heartbeat": (0x1016, 1),
        "node-guarding": LIFE_TIME_FACTOR,
        "rpdo-timer": (0x1400, 5),
    }.get(kind)
    if kind == "node-guarding" and not carries_remote_frames(settings.bus):
        interface = settings.bus.get("interface")
        return stop(
            "own stop",
            f"its profile has node guarding, and python-can's interface {interface} carries no "
            "remote frames: use another interface, or a profile with another watchdog.",
        )
    if address is not None and node.writable(*address):
        return ok(
            "own stop",
            f"it will watch this master (0x{address[0]:04X}:{address[1]}) and stop by itself "
            f"{drive.heartbeat_timeout_s:g} s after its last word.",
        )
    lacking = "by its profile" if address is None else f"(no 0x{address[0]:04X}:{address[1]})"
    text = f"it does not stop by itself {lacking}"
    if drive.without_watchdog:
        return change("own stop", f"{text}; acknowledged. Keep the emergency stop at hand.")
    return stop("own stop", f"{text}: acknowledge with drive.without_watchdog = true.")


def _encoder(node: Node, encoder: EncoderSettings) -> list[Finding]:
    findings = [
        _checked(
            "encoder's identity",
            lambda: identify(node, encoder.node, None),
            f"{node.name} is what the rig file says.",
        )
    ]
    if node.has(0x6001):
        findings.append(
            _checked(
                "encoder's counts",
                lambda: check_ratio(
                    f"{node.name}: measuring units per revolution (0x6001)",
                    "encoder.counts_per_revolution",
                    encoder.counts_per_revolution,
                    node.read(0x6001),
                    1,
                ),
                f"{encoder.counts_per_revolution} in a revolution, as it says itself.",
            )
        )
    return findings


@contextmanager
def lowered_torque(settings: CanopenSettings, per_mille: int) -> Iterator[Finding]:
    """The drive's torque limit (0x6072) lowered while the block runs, where it has one.

    Errors as `opened`, and DriveError where the drive refuses or does not take its own value back;
    what it may then still have is said.
    """
    with opened(settings) as line:
        node = open_drive(line, settings.drive)
        before = node.read(0x6072) if node.writable(0x6072) else None
    if before is None:
        yield note("torque limit", "the drive has no 0x6072 to lower: limits.torque_nm trips.")
        return
    lowered = min(per_mille, before)
    try:
        _limit_torque(settings, lowered)
        yield ok("torque limit", f"0x6072 lowered from {before} to {lowered} 1/1000.")
    finally:
        try:
            _limit_torque(settings, before)
        except BenchError as error:
            raise type(error)(
                f"{error} 0x6072 may still be {lowered} per mille, was {before}: write it back."
            ) from error


def _limit_torque(settings: CanopenSettings, per_mille: int) -> None:
    with opened(settings) as line:
        open_drive(line, settings.drive).configure(0x6072, 0, per_mille)


def rated_nm(settings: CanopenSettings) -> float | None:
    """The drive's rated torque, asked; None where it does not tell. Errors as `opened`."""
    with opened(settings) as line:
        return rated_torque_nm(open_drive(line, settings.drive), settings.drive.profile.units)
