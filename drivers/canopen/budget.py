"""How much of a CAN bus a period takes, as a sum that can be checked by hand.

    bits of a frame with n data bytes  =  47 + 8 n + floor((34 + 8 n - 1) / 4)

with 11-bit identifiers, the worst stuffing, and the three bits between frames (ISO 11898-1). A
period is SYNC's: SYNC, every TPDO, the RPDO or its share where one command serves several SYNCs,
and the share of the heartbeats, or of node guarding's questions and answers.
"""

from dataclasses import dataclass

from canopen.objectdictionary import ObjectDictionary

from drivers.canopen.eds import load_eds
from drivers.canopen.profile import CURRENT, LOAD_POSITION, Address
from drivers.canopen.settings import CanopenSettings, bit_rate
from drivers.errors import SettingsError

BIT_RATES = (1_000_000, 500_000, 250_000, 125_000)
FULL = 0.7
"""A bus that is fuller than this delays frames by more than a few of them."""
HOLDS = 0.9
"""A bus that is fuller than this holds no emergency, SDO, or repeated frame besides: refused."""
_HEARTBEAT_BYTES = 1
_ONCE_EXAMINED_S = 1.2e-3
"""A longer period than this holds every frame that an axis can have, at 1 Mbit/s."""
REMEDY = (
    "Raise the bit rate, lengthen the period, or lower drive.samples_per_command: every answer "
    "comes with every SYNC."
)


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame of a period: what it is, its data bytes, and how many of it a period has."""

    name: str
    data_bytes: int
    per_period: float = 1.0

    @property
    def bits(self) -> float:
        """What it takes in a period."""
        return frame_bits(self.data_bytes) * self.per_period


@dataclass(frozen=True, slots=True)
class BusBudget:
    """The frames of one period."""

    frames: tuple[Frame, ...]
    period_s: float

    @property
    def bits(self) -> float:
        """All of them."""
        return sum(frame.bits for frame in self.frames)

    def load(self, bit_rate: int) -> float:
        """The share of the bus's time, 1 being all of it."""
        return self.bits / (bit_rate * self.period_s)

    def holds(self, bit_rate: int) -> bool:
        """Whether they fit into the period, with room for what is not of every period."""
        return self.load(bit_rate) <= HOLDS

    def __str__(self) -> str:
        parts = ", ".join(f"{frame.name} {frame.bits:.0f}" for frame in self.frames)
        return f"{parts}: {self.bits:.0f} bits"


def frame_bits(data_bytes: int) -> int:
    """The longest that a data frame can be, in bits."""
    return 47 + 8 * data_bytes + (34 + 8 * data_bytes - 1) // 4


def bus_budget(settings: CanopenSettings) -> BusBudget:
    """The frames that this axis puts on its bus. SettingsError for an EDS that cannot be."""
    drive, profile = settings.drive, settings.drive.profile
    dictionary = load_eds(drive.node.eds, drive.node.node_id)
    second = drive.second_encoder
    load = profile.second_encoder or (0x60E4, second.sensor) if second else None
    known = {LOAD_POSITION: load, CURRENT: profile.units.current.object}
    command = Frame(
        "RPDO", _bytes(dictionary, profile.command.objects), 1.0 / settings.command_every
    )
    frames = [command, Frame("SYNC", 0)]
    for answer in profile.answers:
        needs = known.get(answer.needs) if isinstance(answer.needs, str) else answer.needs
        if answer.needs is not None and needs is None:
            continue
        optional = [known[it] if isinstance(it, str) else it for it in answer.optional]
        there = tuple(it for it in optional if it is not None and _mappable(dictionary, it))
        if answer.objects or there:
            frames.append(Frame(f"TPDO{answer.pdo}", _bytes(dictionary, answer.objects + there)))
    nodes = 2
    if settings.encoder is not None:
        nodes += 1
        node = settings.encoder.node
        encoder = load_eds(node.eds, node.node_id)
        objects: tuple[Address, ...] = ((0x6004, 0),)
        objects += ((0x1013, 0),) if _mappable(encoder, (0x1013, 0)) else ()
        frames.append(Frame("encoder's TPDO2", _bytes(encoder, objects)))
    per_period = settings.period_s / drive.heartbeat_s
    if profile.stopping.watchdog == "node-guarding":
        nodes -= 2  # the master's heartbeat and the drive's
        frames.append(Frame("guarding's question", 0, per_period))
        frames.append(Frame("its answer", _HEARTBEAT_BYTES, per_period))
    if nodes:
        frames.append(Frame("heartbeats", _HEARTBEAT_BYTES, nodes * per_period))
    return BusBudget(tuple(frames), settings.period_s)


def check_bus_load(settings: CanopenSettings) -> None:
    """Raise SettingsError where the bit rate ([bus] bitrate, else the fastest) cannot hold this."""
    configured = bit_rate(settings.bus)
    if configured is None and settings.period_s > _ONCE_EXAMINED_S:
        return
    rate = configured or BIT_RATES[0]
    budget = bus_budget(settings)
    if not budget.holds(rate):
        raise SettingsError(
            f"SYNC every {settings.period_s * 1e3:g} ms does not go over this bus: {budget}, which "
            f"is {100 * budget.load(rate):.0f} % of {rate // 1000} kbit/s, allowed "
            f"{100 * HOLDS:.0f} %. {REMEDY}"
        )


def _bytes(dictionary: ObjectDictionary, objects: tuple[Address, ...]) -> int:
    variables = [dictionary.get_variable(*address) for address in objects]
    return sum(len(variable) // 8 for variable in variables if variable is not None)


def _mappable(dictionary: ObjectDictionary, address: Address) -> bool:
    variable = dictionary.get_variable(*address)
    return variable is not None and bool(variable.pdo_mappable)
