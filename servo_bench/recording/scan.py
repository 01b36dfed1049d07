"""An MCAP file from its first record to the last that is whole: one walk for every kind of file.

A record is an opcode (one byte), the length of its content (eight bytes), and the content; a chunk
holds records of its own (https://mcap.dev/spec). The walk needs neither index nor summary, so a
file that was cut is read just like a whole one, and stops at the data section's end.

Messages of one length and channel that follow each other are found together: where the record at
p is n bytes long and a record with the same opcode, length and channel stands at p + n, a walk
from record to record would have come to that one too. So all of them are one (count, n) array,
without a step of Python each.

Whatever the bytes are, nothing but the values below comes out, and no more is held at a time than
the file and one chunk.
"""

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Metadata, Schema
from numpy.typing import NDArray

from servo_bench.recording.format import MAX_CHUNK_BYTES, MAX_UNPACKED_BYTES, MIB
from servo_bench.recording.unpack import DamageError, unpack

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = 9
MESSAGE_HEAD = np.dtype(
    [("channel_id", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")]
)
MESSAGE_BODY = RECORD_HEAD + MESSAGE_HEAD.itemsize
"""Where a message's own bytes begin in its record."""

_FRAME = struct.Struct("<BQ")
_ALIKE = RECORD_HEAD + 2  # opcode, length, channel
FOOTER_BODY = 20
_RUN = 1024  # bounds what a look ahead costs where every message has another length
_UNREADABLE = (McapError, struct.error, ValueError, OverflowError)


@dataclass(frozen=True, slots=True)
class Messages:
    """Records of messages on one channel, all of one length; `records` has shape (count, bytes)."""

    channel_id: int
    records: NDArray[np.uint8]

    @property
    def heads(self) -> NDArray[np.void]:
        """The messages' MESSAGE_HEAD, shape (count,)."""
        raw = np.ascontiguousarray(self.records[:, RECORD_HEAD:MESSAGE_BODY])
        heads: NDArray[np.void] = raw.view(MESSAGE_HEAD)[:, 0]
        return heads

    @property
    def bodies(self) -> NDArray[np.uint8]:
        """The messages' own bytes, shape (count, bytes); a view."""
        return self.records[:, MESSAGE_BODY:]


@dataclass(frozen=True, slots=True)
class Skipped:
    """Bytes of the file that could not be read although the records around them can."""

    offset: int
    length: int
    why: str


@dataclass(frozen=True, slots=True)
class End:
    """Where the walk ended: at the end of a whole file, or after the last record that is whole.

    `lost_bytes` are those of a record whose end is missing. Where only the summary is, it is 0.
    """

    offset: int
    whole: bool
    lost_bytes: int


Item = Schema | Channel | Metadata | Attachment | Messages | Skipped | End


def scan(data: bytes) -> Iterator[Item]:
    """Everything in a file that begins with MAGIC, in its order; the last item is the End."""
    unpacked = 0
    for block in _blocks(data, len(MAGIC)):
        if block.opcode in (Opcode.DATA_END, Opcode.FOOTER):
            yield from _checked(data, block)
            whole = data.endswith(MAGIC) and len(data) >= block.stop + len(MAGIC)
            yield End(block.stop, whole, lost_bytes=0)
            return
        if block.opcode == TORN:
            yield from _torn_chunk(data[block.offset :])
            yield End(block.offset, whole=False, lost_bytes=block.stride)
            return
        if block.opcode != Opcode.CHUNK:
            yield from _items(data, block, block.offset)
            continue
        try:
            chunk = _parsed(Chunk.read, data, block)
            unpacked += min(chunk.uncompressed_size, MAX_CHUNK_BYTES)
            if unpacked > MAX_UNPACKED_BYTES:
                raise DamageError(
                    f"with it the file unpacks to more than {MAX_UNPACKED_BYTES / MIB} MiB"
                )
            records = unpack(chunk)
        except DamageError as damage:
            yield Skipped(block.offset, block.stride, f"chunk at byte {block.offset}: {damage}")
            yield from _declared_again(data)
            continue
        for inner in _blocks(records, 0):
            yield from _items(records, inner, block.offset)
    yield End(len(data), whole=False, lost_bytes=0)


TORN = 0
"""An opcode that no record has: the rest, which is not a whole record."""


@dataclass(frozen=True, slots=True)
class _Block:
    """`count` records of `stride` bytes each, from `offset`, alike in opcode, length, channel."""

    opcode: int
    offset: int
    stride: int
    count: int = 1

    @property
    def stop(self) -> int:
        return self.offset + self.stride * self.count


def _blocks(data: bytes, offset: int) -> Iterator[_Block]:
    """The records in `data` from `offset` on; what is left over at the end is a TORN one."""
    while offset + RECORD_HEAD <= len(data):
        opcode, length = _FRAME.unpack_from(data, offset)
        stride = RECORD_HEAD + length
        short = opcode == Opcode.MESSAGE and stride < MESSAGE_BODY
        if opcode == TORN or short or offset + stride > len(data):
            break
        count = _run(data, offset, stride) if opcode == Opcode.MESSAGE else 1
        block = _Block(opcode, offset, stride, count)
        yield block
        offset = block.stop
    if offset < len(data):
        yield _Block(TORN, offset, len(data) - offset)


def _run(data: bytes, offset: int, stride: int) -> int:
    following = offset + stride
    if data[following : following + _ALIKE] != data[offset : offset + _ALIKE]:
        return 1
    count = min(_RUN, (len(data) - offset) // stride)
    table = np.frombuffer(data, np.uint8, count * stride, offset).reshape(count, stride)
    alike = (table[:, :_ALIKE] == table[0, :_ALIKE]).all(axis=1)
    return count if alike.all() else int(np.argmin(alike))


def _items(data: bytes, block: _Block, file_offset: int) -> Iterator[Item]:
    """What a block says that a recording needs; nothing for an index, a statistic, a stranger."""
    if block.opcode == Opcode.MESSAGE:
        flat = np.frombuffer(data, np.uint8, block.count * block.stride, block.offset)
        records = flat.reshape(block.count, block.stride)
        channel_id = int.from_bytes(records[0, RECORD_HEAD:_ALIKE].tobytes(), "little")
        yield Messages(channel_id, records)
    elif block.opcode == TORN:
        yield Skipped(
            file_offset, block.stride, f"chunk at byte {file_offset}: it ends in a record"
        )
    elif block.opcode in _READERS:
        try:
            yield _parsed(_READERS[block.opcode], data, block)
        except DamageError as damage:
            yield Skipped(file_offset, block.stride, f"record at byte {file_offset}: {damage}")


_READERS: dict[int, Callable[[ReadDataStream], Any]] = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.ATTACHMENT: Attachment.read,
}


def _parsed(read: Callable[[ReadDataStream], Any], data: bytes, block: _Block) -> Any:
    """A record by the library's own reader, which sees no byte beyond the record's end."""
    content = data[block.offset + RECORD_HEAD : block.stop]
    try:
        return read(ReadDataStream(BytesIO(content)))
    except _UNREADABLE as error:
        raise DamageError(f"its content is not what its kind holds ({error!r})") from error


def _checked(data: bytes, end: _Block) -> Iterator[Skipped]:
    """Nothing, or that the data section is not what its checksum says (0: it has none)."""
    if end.opcode != Opcode.DATA_END:
        return
    try:
        expected = _parsed(DataEnd.read, data, end).data_section_crc
        if expected and expected != zlib.crc32(memoryview(data)[: end.offset]):
            raise DamageError("the checksum of all before it is wrong")
    except DamageError as damage:
        yield Skipped(end.offset, 0, f"record at byte {end.offset}: {damage}")


def _declared_again(data: bytes) -> Iterator[Item]:
    """The schemas and channels that a whole file repeats in its summary.

    The only other place that says them is the first chunk, and without them no other can be read.
    """
    footer = len(data) - len(MAGIC) - RECORD_HEAD - FOOTER_BODY
    if not data.endswith(MAGIC) or footer < len(MAGIC) or data[footer] != Opcode.FOOTER:
        return
    (start,) = struct.unpack_from("<Q", data, footer + RECORD_HEAD)
    if len(MAGIC) <= start < footer:
        for block in _blocks(data, start):
            if block.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                yield from _items(data, block, block.offset)


def _torn_chunk(rest: bytes) -> Iterator[Item]:
    """The records that can be read of a chunk whose end is missing."""
    if len(rest) < RECORD_HEAD or rest[0] != Opcode.CHUNK:
        return
    try:
        chunk = _parsed(Chunk.read, rest, _Block(Opcode.CHUNK, 0, len(rest)))
        records = unpack(chunk, torn=True)
    except DamageError:
        return
    for block in _blocks(records, 0):
        if block.opcode != TORN:
            yield from _items(records, block, 0)
