"""What goes over the wire in a period: the transactions that a profile's `[cycle]` comes to.

One transaction where the drive has function 23 and one read block is enough; else the write, then
one read for each block. The write comes first, so that its time is the slot's.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from itertools import pairwise

from pymodbus.pdu import ModbusPDU

from drivers.modbus.frames import read_request, read_write_request, write_request
from drivers.modbus.profile import LOAD, TEMPERATURE, DriveProfile
from drivers.modbus.registers import Codec, Number


@dataclass(frozen=True, slots=True)
class Block:
    """Neighbouring registers and the items in them."""

    function: int
    address: int
    count: int
    items: tuple[tuple[str, Codec, int], ...]
    """Name, codec, and how far behind `address` it begins."""

    @property
    def names(self) -> tuple[str, ...]:
        """The items' names."""
        return tuple(name for name, _, _ in self.items)

    def encode(self, digits: Mapping[str, Number]) -> list[int]:
        """The registers, for every item's digits. ValueError where one does not fit."""
        words = [0] * self.count
        for name, codec, offset in self.items:
            words[offset : offset + codec.item.words] = codec.encode(digits[name])
        return words

    def decode(self, words: Sequence[int]) -> dict[str, Number]:
        """Every item's digits."""
        return {
            name: codec.decode(words[offset : offset + codec.item.words])
            for name, codec, offset in self.items
        }


@dataclass(frozen=True, slots=True)
class Exchange:
    """One transaction: a write, a read, or both at once."""

    write: Block | None
    read: Block | None
    spare_words: int = 0

    def request(self, digits: Mapping[str, Number], lost: int = 0) -> ModbusPDU:
        """The request; `lost` answers so far choose its length, where there are spare words."""
        extra = lost % (self.spare_words + 1)
        write, read = self.write, self.read
        if write is not None and read is not None:
            words = write.encode(digits)
            return read_write_request(read.address, read.count + extra, write.address, words)
        if write is not None:
            return write_request(write.function, write.address, write.encode(digits))
        assert read is not None  # noqa: S101 - an exchange has at least one of the two
        return read_request(read.function, read.address, read.count + extra)


@dataclass(frozen=True, slots=True)
class Plan:
    """The transactions of one period, in their order; and the reads alone."""

    exchanges: tuple[Exchange, ...]
    reads: tuple[Exchange, ...]


def plan_of(profile: DriveProfile, without: Set[str] = frozenset()) -> Plan:
    """The plan of a profile; read blocks whose items are all in `without` are left out, and the
    drive's temperature where it is in `without`.

    Raises ValueError where a block cannot be asked for in one request.
    """
    functions = profile.functions
    words = functions.words_per_read
    dropped = without & {TEMPERATURE}
    blocks = [
        _block(profile, [it for it in names if it not in dropped], words, reading=True)
        for names in profile.cycle.read
        if not set(names) <= without
    ]
    spare = functions.spare_read_words if len(blocks) == 1 else 0
    reads = tuple(Exchange(None, block, spare) for block in blocks)
    if not profile.is_commanded:
        return Plan(reads, reads)
    write = _block(profile, profile.cycle.write, functions.words_per_write, reading=False)
    if functions.read_write is not None and len(blocks) == 1:
        return Plan((Exchange(write, blocks[0], spare),), reads)
    return Plan((Exchange(write, None), *reads), reads)


def unused_items(*, has_load: bool, limits_temperature: bool = False) -> frozenset[str]:
    """What a rig does not need of the profile's items."""
    needed = {LOAD: has_load, TEMPERATURE: limits_temperature}
    return frozenset(name for name, is_needed in needed.items() if not is_needed)


def _block(profile: DriveProfile, names: Sequence[str], limit: int, *, reading: bool) -> Block:
    """Names to one request. They may leave gaps where they are read, never where written."""
    side = "read" if reading else "write"
    entries = sorted((profile.items[name].address, name) for name in names)
    codecs = [(name, profile.codec(name)) for _, name in entries]
    if not codecs:
        raise ValueError(f"[cycle] {side} has an empty block")
    for (first, one), (second, other) in pairwise(codecs):
        gap = other.item.address - one.item.end
        if gap < 0 or (gap > 0 and not reading):
            trouble = "overlap" if gap < 0 else "have a gap between them"
            raise ValueError(f"[cycle] {side}: {first} and {second} {trouble} in one block")
    address = codecs[0][1].item.address
    count = codecs[-1][1].item.end - address
    if count > limit:
        raise ValueError(
            f"[cycle] {side}: {codecs[0][0]} to {codecs[-1][0]} are {count} registers, the drive "
            f"takes {limit} in a request"
        )
    wanted = {_function(profile, codec, reading=reading) for _, codec in codecs}
    if len(wanted) != 1:
        raise ValueError(f"[cycle] {side}: one block needs one function code, not {wanted}")
    function = wanted.pop()
    if function == 6 and count != 1:
        raise ValueError(f"[cycle] {side}: function 6 writes one register, the block has {count}")
    items = tuple((name, codec, codec.item.address - address) for name, codec in codecs)
    return Block(function, address, count, items)


def _function(profile: DriveProfile, codec: Codec, *, reading: bool) -> int:
    if reading:
        return codec.item.read or profile.functions.read
    return write_function(profile, codec)


def write_function(profile: DriveProfile, codec: Codec) -> int:
    """With which function an item is written."""
    return codec.item.write or profile.functions.write
