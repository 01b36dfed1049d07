"""Sets a drive and an encoder up by SDO, up to NMT operational. Nothing is enabled here.

    pre-operational → identity → scaling → supervision → mode and period → PDOs → operational

Every object that is written is read back. An object that the EDS lacks is done without; where
that matters, `note(kind, text)` is told. Sources: CiA 301, CiA 402-2, CiA 406.
"""

from collections.abc import Callable
from dataclasses import dataclass

from drivers.canopen import cia402, pdo
from drivers.canopen.eds import load_eds
from drivers.canopen.guarding import LIFE_TIME_FACTOR
from drivers.canopen.line import Line
from drivers.canopen.mapping import Mapping, map_drive
from drivers.canopen.node import (
    NMT_PRE_OPERATIONAL,
    NMT_START,
    OPERATIONAL,
    Node,
)
from drivers.canopen.pdo import TPDO, Layout
from drivers.canopen.profile import Address
from drivers.canopen.scaling import DriveScale, check_ratio
from drivers.canopen.settings import CanopenSettings, DriveSettings, EncoderSettings, NodeSettings
from drivers.canopen.stopping import prepare_stop, watch_master, without_heartbeat
from drivers.canopen.timing import prepare_sync, produce_sync, set_interpolation_time
from drivers.canopen.units import read_drive_scale
from drivers.errors import DriveError, SettingsError, WireError

Note = Callable[[str, str], None]

_MODE_POLL_S = 0.01

_DRIVE_OBJECTS = (0x1018, 0x1400, 0x1600, 0x1800, 0x1A00, 0x6040, 0x6041, 0x6060, 0x6064, 0x60FF)
_ENCODER_OBJECTS = (0x1018, 0x1801, 0x1A01, 0x6004)


@dataclass(frozen=True, slots=True)
class DriveLink:
    """A drive that is set up: what the cycle sends and reads, and what it is worth.

    `watchdog` is the object by which the drive watches this master, None where it does not.
    """

    node: Node
    mapping: Mapping
    scale: DriveScale
    watchdog: Address | None
    sends_heartbeat: bool

    @property
    def guarded(self) -> bool:
        """Whether this master asks for its state (node guarding) instead of hearing it."""
        return self.watchdog == LIFE_TIME_FACTOR


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
    identify(node, drive.node, drive.profile.vendor_id)
    _power_off(node, note)
    scale = read_drive_scale(node, drive, note)
    guarded = without_heartbeat(node, settings)
    sends_heartbeat = _produce_heartbeat(node, 0.0 if guarded else drive.heartbeat_s, note)
    watchdog = watch_master(node, settings, note)
    prepare_stop(node, drive.profile.stopping)
    timing = drive.profile.timing
    needed = timing.sync_period_needed or settings.sync_by_drive
    prepare_sync(node, settings.period_s, needed=needed)
    _select_mode(node, drive, note)
    set_interpolation_time(node, settings)
    if timing.command_delay_cycles:
        note(
            "command delay",
            f"{node.name}: a command acts {timing.command_delay_cycles} SYNC(s) after the one that "
            "it precedes, by its profile.",
        )
    mapping = map_drive(node, drive, scale)
    link = DriveLink(node, mapping, scale, watchdog, sends_heartbeat)
    if settings.sync_by_drive:
        produce_sync(node)
    _start(node, drive.enable_timeout_s, confirmed_by_heartbeat=sends_heartbeat)
    return link


def set_up_encoder(
    node: Node, encoder: EncoderSettings, drive: DriveSettings, note: Note
) -> EncoderLink:
    """Make the encoder answer every SYNC. Errors as `set_up_drive`."""
    node.nmt(NMT_PRE_OPERATIONAL)
    identify(node, encoder.node, None)
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
    prepare_sync(node, None)
    pdo.disable_others(node, {TPDO + 1})
    objects: tuple[Address, ...] = ((0x6004, 0),)
    if node.mappable(0x1013):
        objects += ((0x1013, 0),)
    position = pdo.configure(node, TPDO, 2, objects)
    _start(node, drive.enable_timeout_s, confirmed_by_heartbeat=sends_heartbeat)
    return EncoderLink(node, position, modulus or 1 << 32, sends_heartbeat)


def identify(node: Node, settings: NodeSettings, profile_vendor_id: int | None) -> None:
    """Raise DriveError where this is another device than the settings or the profile name."""
    vendor_id = profile_vendor_id if settings.vendor_id is None else settings.vendor_id
    for sub, what, wanted in (
        (1, "vendor_id", vendor_id),
        (2, "product_code", settings.product_code),
    ):
        if sub > 1 and wanted is None:
            continue  # CiA 301 has every device tell its vendor, the rest is optional
        found = node.read(0x1018, sub)
        if wanted is not None and found != wanted:
            raise DriveError(
                f"{node.name} is another device: it reports {what} = 0x{found:X} (0x1018:{sub}), "
                f"the configuration says 0x{wanted:X}. Check node_id, or correct {what}, the "
                "EDS, and the profile."
            )


def _power_off(node: Node, note: Note) -> None:
    """A drive that somebody left enabled is switched off before anything is changed."""
    statusword = node.read(0x6041)
    if cia402.decode_state(statusword) in cia402.POWERED:
        note("drive found enabled", f"{node.name}: {cia402.describe_statusword(statusword)}.")
        node.write(0x6040, 0, cia402.DISABLE_VOLTAGE)


def _produce_heartbeat(node: Node, period_s: float, note: Note) -> bool:
    """Whether it will send one; a period of 0 s switches it off."""
    if not node.writable(0x1017):
        if period_s:
            note("no heartbeat", f"{node.name} has no 0x1017: it is watched by its answers alone.")
        return False
    node.configure(0x1017, 0, round(period_s * 1e3))
    return period_s > 0.0


def _select_mode(node: Node, drive: DriveSettings, note: Note) -> None:
    mode = cia402.MODES[drive.mode]
    profile = drive.profile
    if drive.mode not in profile.modes:
        raise SettingsError(
            f'{node.name}: {profile.title} has no mode "{drive.mode}". Set drive.mode to '
            f"{' or '.join(profile.modes)}."
        )
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
