"""PDO mapping by SDO, and the layout that the cycle packs and unpacks by.

A PDO is described by two records: communication (0x1400, 0x1800 + n: COB-ID, type, inhibit time,
event timer) and mapping (0x1600, 0x1A00 + n: index << 16 | sub << 8 | bits). CiA 301 allows
a change only in this order: COB-ID invalid (bit 31), mapping count 0, entries, count, COB-ID
valid. Bit 30 (no RTR) is kept as the device has it. Everything is read back.
"""

import struct
from dataclasses import dataclass

from canopen.objectdictionary import datatypes

from drivers.canopen.node import Node
from drivers.canopen.profile import Address
from drivers.errors import DriveError

RPDO, TPDO = 0x1400, 0x1800
_MAPPING = 0x200
_INVALID, _NO_RTR = 1 << 31, 1 << 30
_ON_SYNC = 1
_COB_BASE = {RPDO: 0x200, TPDO: 0x180}
_CODES = {
    datatypes.INTEGER8: "b",
    datatypes.UNSIGNED8: "B",
    datatypes.INTEGER16: "h",
    datatypes.UNSIGNED16: "H",
    datatypes.INTEGER32: "i",
    datatypes.UNSIGNED32: "I",
}


@dataclass(frozen=True, slots=True)
class Layout:
    """One PDO as it goes over the wire: its COB-ID, the objects in it, and how to pack them."""

    cob_id: int
    objects: tuple[Address, ...]
    codec: struct.Struct

    def place(self, address: Address) -> int | None:
        """Where in the unpacked values an object stands; None where it is not mapped."""
        return self.objects.index(address) if address in self.objects else None


def layout(node: Node, kind: int, number: int, objects: tuple[Address, ...]) -> Layout:
    """The layout of PDO `number` (from 1) with these objects, types from the EDS.

    Raises DriveError for a type that is no integer of 8, 16, or 32 bits, or more than 8 bytes.
    """
    codes = []
    for index, sub in objects:
        code = _CODES.get(node.variable(index, sub).data_type or 0)
        if code is None:
            raise DriveError(
                f"{node.name}: the EDS gives 0x{index:04X}:{sub} a type that is no integer of 8, "
                "16, or 32 bits, so it cannot go into a PDO here. Correct the EDS."
            )
        codes.append(code)
    codec = struct.Struct("<" + "".join(codes))
    if codec.size > 8:
        raise DriveError(
            f"{node.name}: the objects {', '.join(f'0x{i:04X}:{n}' for i, n in objects)} have "
            f"{codec.size} bytes by the EDS, a PDO has 8. Correct their types in the EDS."
        )
    return Layout(_COB_BASE[kind] + 0x100 * (number - 1) + node.node_id, objects, codec)


def configure(
    node: Node, kind: int, number: int, objects: tuple[Address, ...], *, fixed: bool = False
) -> Layout:
    """Map these objects into a PDO on SYNC and read everything back; returns its layout.

    With a `fixed` mapping only the communication record is written. The node must be
    pre-operational. Raises DriveError where it refuses or keeps something else.
    """
    wanted = layout(node, kind, number, objects)
    communication = kind + number - 1
    mapping = communication + _MAPPING
    no_rtr = node.read(communication, 1) & _NO_RTR
    entries = [i << 16 | sub << 8 | len(node.variable(i, sub)) for i, sub in objects]

    node.write(communication, 1, _INVALID | no_rtr | wanted.cob_id)
    node.write(communication, 2, _ON_SYNC, "This PDO must be possible on every SYNC (type 1).")
    if kind == TPDO:
        for timer in (3, 5):  # inhibit time, event timer
            if node.writable(communication, timer):
                node.write(communication, timer, 0)
    if not fixed:
        _map(node, mapping, entries)
    node.write(communication, 1, no_rtr | wanted.cob_id)

    expected = [(communication, 1, no_rtr | wanted.cob_id), (communication, 2, _ON_SYNC)]
    expected += [(mapping, 0, len(entries))]
    expected += [(mapping, sub, entry) for sub, entry in enumerate(entries, start=1)]
    for index, sub, value in expected:
        kept = node.read(index, sub)
        if kept != value and not (sub == 1 and kept ^ value == _NO_RTR):
            raise DriveError(
                f"{node.name} keeps 0x{index:04X}:{sub} = 0x{kept:X} where the master wrote "
                f"0x{value:X}: its PDOs would be misread. Reset the device to its defaults."
            )
    return wanted


def _map(node: Node, mapping: int, entries: list[int]) -> None:
    node.write(
        mapping,
        0,
        0,
        'The mapping of this PDO cannot be changed: say mapping = "fixed" in the drive profile and '
        "list there what the device has mapped.",
    )
    for sub, entry in enumerate(entries, start=1):
        node.write(mapping, sub, entry, "The device cannot map this object into this PDO.")
    node.write(mapping, 0, len(entries))


def disable_others(node: Node, used: set[int]) -> None:
    """Switch off every PDO of the EDS whose communication record is not in `used`."""
    for communication in node.dictionary:
        is_pdo = any(kind <= communication < kind + _MAPPING for kind in (RPDO, TPDO))
        if not is_pdo or communication in used or not node.writable(communication, 1):
            continue
        cob_id = node.read(communication, 1)
        if not cob_id & _INVALID:
            node.write(communication, 1, _INVALID | cob_id)
