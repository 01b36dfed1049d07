"""Sets a drive and an encoder up by SDO, up to NMT operational. Nothing is enabled here.

    pre-operational → identity → scaling → supervision → mode and period → PDOs → operational

Every object that is written is read back. An object that the EDS lacks is done without; where
that matters, `note(kind, text)` is told. Sources: CiA 301, CiA 402-2, CiA 406.
"""

from collections.abc import Callable
from dataclasses import dataclass

from drivers.canopen import cia402, pdo
from drivers.canopen.eds import load_eds
from drivers.canopen.line import Line
from drivers.canopen.node import (
    NMT_PRE_OPERATIONAL,
    NMT_START,
    OPERATIONAL,
    SYNC,
    Node,
)
from drivers.canopen.pdo import RPDO, TPDO, Layout
from drivers.canopen.scaling import (
    INCREMENTS_PER_SECOND,
    DriveScale,
    check_ratio,
    drive_scale,
)
from drivers.canopen.settings import CanopenSettings, DriveSettings, EncoderSettings, NodeSettings
from drivers.errors import DriveError, SettingsError, WireError

Note = Callable[[str, str], None]

_QUICK_STOP_ON_LOSS = 3  # 0x6007
_SLOW_DOWN_AND_DISABLE = 2  # 0x605A: quick stop ramp, then switch on disabled
_SYNC_PRODUCER = 1 << 30
_MODE_POLL_S = 0.01
_NO_FEED_CONSTANT = (1, 1)
"""0x6092 as drives ship it that count increments: whole revolutions as a unit would be useless."""

_DRIVE_OBJECTS = (0x1018, 0x1400, 0x1600, 0x1800, 0x1A00, 0x6040, 0x6041, 0x6060, 0x6064, 0x60FF)
_ENCODER_OBJECTS = (0x1018, 0x1801, 0x1A01, 0x6004)


@dataclass(frozen=True, slots=True)
class DriveLink:
    """A drive that is set up: what the cycle sends and reads, and what it is worth.

    `watches_master` tells whether the drive stops by itself when this master falls silent.
    """

    node: Node
    command: Layout
    state: Layout
    motion: Layout | None
    scale: DriveScale
    watches_master: bool
    sends_heartbeat: bool


@dataclass(frozen=True, slots=True)
class EncoderLink:
    """An encoder that is set up. `modulus` is where its count wraps."""

    node: Node
    position: Layout
    modulus: int
    sends_heartbeat: bool


def open_drive(line: Line, settings: DriveSettings) -> Node:
    """The drive as a node, its EDS loaded; SettingsError for a bad EDS."""
    return _open("drive", line, settings.node, settings.sdo_timeout_s, _DRIVE_OBJECTS)


def open_encoder(line: Line, settings: EncoderSettings, sdo_timeout_s: float) -> Node:
    """The encoder as a node, its EDS loaded; SettingsError for a bad EDS."""
    return _open("encoder", line, settings.node, sdo_timeout_s, _ENCODER_OBJECTS)


def _open(
    name: str, line: Line, node: NodeSettings, timeout_s: float, required: tuple[int, ...]
) -> Node:
    dictionary = load_eds(node.eds, node.node_id, required)
    return Node(name, node.node_id, dictionary, line, timeout_s)


def set_up_drive(node: Node, settings: CanopenSettings, note: Note) -> DriveLink:
    """Make the drive ready to be enabled by PDO.

    Raises WireError where it does not answer, DriveError where it is another device or refuses,
    SettingsError where it contradicts the configuration.
    """
    drive = settings.drive
    node.nmt(NMT_PRE_OPERATIONAL)
    _identify(node, drive.node)
    _power_off(node, note)
    scale = _read_drive_scale(node, drive, note)
    sends_heartbeat = _produce_heartbeat(node, drive.heartbeat_s, note)
    watches_master = _watch_master(node, settings, note)
    _prepare_stop(node)
    _prepare_sync(node, settings.period_s)
    _select_mode(node, drive, note)
    _set_period(node, settings.period_s)
    state_objects = (0x6041, 0x6064) + ((0x6077,) if scale.nm_per_permille else ())
    motion_objects = tuple(index for index in (0x606C, 0x1013) if node.mappable(index))
    pdo.disable_others(node, {RPDO, TPDO} | ({TPDO + 1} if motion_objects else set()))
    link = DriveLink(
        node=node,
        command=pdo.configure(node, RPDO, 1, (0x6040, 0x60FF)),
        state=pdo.configure(node, TPDO, 1, state_objects),
        motion=pdo.configure(node, TPDO, 2, motion_objects) if motion_objects else None,
        scale=scale,
        watches_master=watches_master,
        sends_heartbeat=sends_heartbeat,
    )
    _start(node, drive.enable_timeout_s, confirmed_by_heartbeat=sends_heartbeat)
    return link


def set_up_encoder(
    node: Node, encoder: EncoderSettings, drive: DriveSettings, note: Note
) -> EncoderLink:
    """Make the encoder answer every SYNC. Errors as `set_up_drive`."""
    node.nmt(NMT_PRE_OPERATIONAL)
    _identify(node, encoder.node)
    if node.has(0x6001):
        check_ratio(
            f"{node.name}: measuring units per revolution (0x6001)",
            "encoder.counts_per_revolution",
            encoder.counts_per_revolution,
            node.read(0x6001),
            1,
        )
    modulus = node.read(0x6002) if node.has(0x6002) else 0
    sends_heartbeat = _produce_heartbeat(node, drive.heartbeat_s, note)
    _prepare_sync(node, None)
    pdo.disable_others(node, {TPDO + 1})
    objects = (0x6004,) + ((0x1013,) if node.mappable(0x1013) else ())
    position = pdo.configure(node, TPDO, 2, objects)
    _start(node, drive.enable_timeout_s, confirmed_by_heartbeat=sends_heartbeat)
    return EncoderLink(node, position, modulus or 1 << 32, sends_heartbeat)


def _identify(node: Node, settings: NodeSettings) -> None:
    for sub, what, wanted in (
        (1, "vendor_id", settings.vendor_id),
        (2, "product_code", settings.product_code),
    ):
        found = node.read(0x1018, sub)
        if wanted is not None and found != wanted:
            raise DriveError(
                f"{node.name} is another device: it reports {what} = 0x{found:X} (0x1018:{sub}), "
                f"the configuration says 0x{wanted:X}. Check node_id, or correct {what} and "
                "the EDS."
            )


def _power_off(node: Node, note: Note) -> None:
    """A drive that somebody left enabled is switched off before anything is changed."""
    statusword = node.read(0x6041)
    if cia402.decode_state(statusword) in cia402.POWERED:
        note("drive found enabled", f"{node.name}: {cia402.describe_statusword(statusword)}.")
        node.write(0x6040, 0, cia402.DISABLE_VOLTAGE)


def _read_drive_scale(node: Node, drive: DriveSettings, note: Note) -> DriveScale:
    counts = drive.counts_per_revolution
    for index, what, setting, wanted in (
        (0x608F, "encoder increments / motor revolutions", "drive.counts_per_revolution", counts),
        (0x6092, "feed / shaft revolutions", "drive.counts_per_revolution", counts),
        (0x6091, "motor / shaft revolutions; drive.gear_ratio belongs to the bench", "ratio", 1),
    ):
        if node.has(index, 1) and node.has(index, 2):
            label = f"{node.name}: 0x{index:04X} ({what})"
            ratio = node.read(index, 1), node.read(index, 2)
            if index != 0x6092 or ratio != _NO_FEED_CONSTANT:
                check_ratio(label, setting, wanted, *ratio)
    if node.has(0x60A9):
        unit = node.read(0x60A9)
    else:
        unit = INCREMENTS_PER_SECOND
        note(
            "velocity unit assumed",
            f"{node.name} has no 0x60A9: its velocities are taken as increments/s.",
        )
    rated_torque_mnm = None
    if node.has(0x6076) and node.mappable(0x6077):
        rated_torque_mnm = node.read(0x6076) or None
    if rated_torque_mnm is None:
        note("no torque", f"{node.name} tells no rated torque (0x6076) or no torque (0x6077).")
    return drive_scale(counts, drive.gear_ratio, drive.direction, unit, rated_torque_mnm)


def _produce_heartbeat(node: Node, period_s: float, note: Note) -> bool:
    if not node.writable(0x1017):
        note("no heartbeat", f"{node.name} has no 0x1017: it is watched by its answers alone.")
        return False
    node.configure(0x1017, 0, round(period_s * 1e3))
    return True


def _watch_master(node: Node, settings: CanopenSettings, note: Note) -> bool:
    """Let the drive stop by itself when this master falls silent."""
    if not node.writable(0x1016, 1):
        note(
            "master not watched",
            f"{node.name} has no 0x1016: it does not stop by itself when this master dies.",
        )
        return False
    timeout_ms = round(settings.drive.heartbeat_timeout_s * 1e3)
    node.configure(0x1016, 1, settings.master_node_id << 16 | timeout_ms)
    return True


def _prepare_stop(node: Node) -> None:
    for index, reaction in ((0x6007, _QUICK_STOP_ON_LOSS), (0x605A, _SLOW_DOWN_AND_DISABLE)):
        if node.writable(index):
            node.configure(index, 0, reaction)


def _prepare_sync(node: Node, period_s: float | None) -> None:
    """The node consumes SYNC on COB-ID 0x80 and knows its period where it asks for one."""
    if node.has(0x1005):
        cob_id = node.read(0x1005)
        if cob_id & (_SYNC_PRODUCER | 0x7FF) != SYNC:
            node.configure(0x1005, 0, SYNC, "This master sends SYNC on 0x80.")
    if period_s is not None and node.writable(0x1006):
        node.configure(0x1006, 0, round(period_s * 1e6))


def _select_mode(node: Node, drive: DriveSettings, note: Note) -> None:
    mode = cia402.MODES[drive.mode]
    if node.has(0x6502):
        supported = node.read(0x6502)
        if not supported >> (mode - 1) & 1:
            raise DriveError(
                f"{node.name} does not support mode {drive.mode} (0x6060 = {mode}): its "
                f"supported modes (0x6502) are 0x{supported:08X}. Choose another drive.mode of "
                f"{', '.join(cia402.MODES)}."
            )
    node.write(0x6060, 0, mode)
    if node.has(0x6061):
        deadline_ns = node.line.clock.now_ns() + round(drive.sdo_timeout_s * 1e9)
        while (shown := node.read(0x6061)) != mode:
            if node.line.clock.now_ns() > deadline_ns:
                raise DriveError(
                    f"{node.name} was told mode {mode} ({drive.mode}) and shows {shown} "
                    "(0x6061). Choose another drive.mode, or see the drive's manual."
                )
            node.line.clock.sleep_s(_MODE_POLL_S)
    if drive.mode == "pv":
        ramps = [f"0x{i:04X} = {node.read(i)}" for i in (0x6083, 0x6084) if node.has(i)]
        note("ramps", f"{node.name} shapes the command with its ramps: {', '.join(ramps)}.")


def interpolation_time(period_s: float) -> tuple[int, int]:
    """0x60C2 for a period: (value, exponent), value · 10^exponent s, value at most 255.

    Raises SettingsError for a period that has no such form.
    """
    for exponent in (-3, -4, -5, -6):
        value = round(period_s * 10**-exponent)
        if 1 <= value <= 255 and abs(value - period_s * 10**-exponent) < 1e-6:
            return value, exponent
    raise SettingsError(
        f"period_s = {period_s:g} is no whole number up to 255 of milliseconds, 0.1 ms, 0.01 ms, "
        "or microseconds, so 0x60C2 cannot say it. Choose such a period, e.g. 0.008."
    )


def _set_period(node: Node, period_s: float) -> None:
    value, exponent = interpolation_time(period_s)
    if not (node.writable(0x60C2, 1) and node.writable(0x60C2, 2)):
        return
    advice = f"The drive cannot run at period_s = {period_s:g}: choose a period that it allows."
    node.configure(0x60C2, 2, exponent, advice)
    node.configure(0x60C2, 1, value, advice)


def _start(node: Node, timeout_s: float, *, confirmed_by_heartbeat: bool) -> None:
    node.nmt(NMT_START)
    if not confirmed_by_heartbeat:
        return
    state = node.wait_for_state(OPERATIONAL, timeout_s)
    if state != OPERATIONAL:
        seen = "no heartbeat came" if state is None else f"its heartbeat says 0x{state:02X}"
        raise WireError(
            f"{node.name} did not become operational within {timeout_s:g} s: {seen} (0x05 is "
            "operational). Power-cycle it."
        )
