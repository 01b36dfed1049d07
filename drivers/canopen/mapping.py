"""Which PDOs of a drive carry what, by its profile and its EDS."""

from dataclasses import dataclass

from drivers.canopen import pdo
from drivers.canopen.node import Node
from drivers.canopen.pdo import RPDO, TPDO, Layout
from drivers.canopen.profile import CURRENT, LOAD_POSITION, TORQUE, Address, AnswerPdo
from drivers.canopen.scaling import DriveScale
from drivers.canopen.settings import DriveSettings
from drivers.errors import SettingsError

_ADDITIONAL_POSITION = 0x60E4


@dataclass(frozen=True, slots=True)
class Mapping:
    """The PDOs of a drive that is set up; `load` and `current` are None where none is mapped."""

    command: Layout
    answers: tuple[Layout, ...]
    load: Address | None
    current: Address | None


def map_drive(node: Node, drive: DriveSettings, scale: DriveScale) -> Mapping:
    """Configure the drive's PDOs. DriveError where it refuses, SettingsError without an encoder."""
    profile = drive.profile
    load = _load(node, drive)
    current = profile.units.current.object if scale.a_per_digit is not None else None
    chosen: dict[int, tuple[Address, ...]] = {}
    for answer in profile.answers:
        objects = _objects(node, answer, {LOAD_POSITION: load, CURRENT: current}, scale)
        if objects:
            chosen[answer.pdo] = objects
    fixed = profile.mapping == "fixed"
    used = {TPDO + number - 1 for number in chosen} | {RPDO + profile.command.pdo - 1}
    pdo.disable_others(node, used)
    command = pdo.configure(node, RPDO, profile.command.pdo, profile.command.objects, fixed=fixed)
    answers = tuple(
        pdo.configure(node, TPDO, number, objects, fixed=fixed)
        for number, objects in chosen.items()
    )
    mapped = {address for layout in answers for address in layout.objects}
    return Mapping(command, answers, load, current if current in mapped else None)


def _load(node: Node, drive: DriveSettings) -> Address | None:
    if drive.second_encoder is None:
        return None
    standard = _ADDITIONAL_POSITION, drive.second_encoder.sensor
    address = drive.profile.second_encoder or standard
    label = f"0x{address[0]:04X}:{address[1]}"
    if not drive.profile.offers_load_position:
        raise SettingsError(
            f"{node.name}: the profile of {drive.profile.title} maps no second encoder "
            "(load_position). Put an encoder of its own on the bus ([encoder]), or complete the "
            "profile."
        )
    if not node.mappable(*address):
        raise SettingsError(
            f"{node.name}: by its EDS {label} (additional position) cannot go into a PDO, or is "
            "not there. Choose another drive.second_encoder.sensor, or put an encoder on the bus."
        )
    return address


def _objects(
    node: Node, answer: AnswerPdo, known: dict[str, Address | None], scale: DriveScale
) -> tuple[Address, ...]:
    """What one answer carries here; empty where it is not wanted."""

    def resolved(entry: Address | str) -> Address | None:
        return known[entry] if isinstance(entry, str) else entry

    if answer.needs is not None and resolved(answer.needs) is None:
        return ()
    optional = [resolved(entry) for entry in answer.optional]
    there = tuple(
        address
        for address in optional
        if address is not None
        and node.mappable(*address)
        and (address != TORQUE or scale.nm_per_digit is not None)
    )
    return answer.objects + there
