"""Unpacking a chunk within bounds: what a file declares about its sizes is never trusted."""

import threading
import zlib

import lz4.frame
import zstandard
from mcap.records import Chunk

from servo_bench.recording.format import MAX_CHUNK_BYTES, MIB


class _Zstd(threading.local):
    """One decompressor for each thread: its memory is not for two at once."""

    def __init__(self) -> None:
        self.decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK_BYTES)


_ZSTD = _Zstd()


class DamageError(Exception):
    """A chunk's bytes are not what they were when they were written."""


def unpack(chunk: Chunk, *, torn: bool = False) -> bytes:
    """The records in a chunk; of a torn one, what can be unpacked of it.

    Raises DamageError for a size above MAX_CHUNK_BYTES or other than declared, a wrong checksum, or
    bytes that are no zstd or lz4 frame. At most one byte more than declared is ever unpacked. Of
    a torn chunk zstd gives whole blocks of up to 128 KiB and lz4 of 64 KiB, so that a small chunk
    gives nothing; without compression all that is there is given. There is no checksum then.
    """
    declared = chunk.uncompressed_size
    if declared > MAX_CHUNK_BYTES:
        raise DamageError(
            f"it declares {declared / MIB:.1f} MiB, and {MAX_CHUNK_BYTES / MIB:.0f} MiB are allowed"
        )
    data = _decompress(chunk.compression, chunk.data, declared + 1)
    if torn:
        return data[:declared]
    if len(data) != declared:
        raise DamageError(f"it unpacks to {len(data)} bytes or more and declares {declared}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise DamageError("its checksum is wrong")
    return data


def _decompress(compression: str, data: bytes, limit: int) -> bytes:
    if compression == "":
        return data[:limit]
    try:
        if compression == "zstd":
            unpacked: bytes = _ZSTD.decompressor.stream_reader(data).read(limit)
            return unpacked
        if compression == "lz4":
            plain: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=limit)
            return plain
    except (zstandard.ZstdError, RuntimeError, EOFError, ValueError) as error:
        raise DamageError(f"it is no {compression} frame ({error})") from error
    raise DamageError(f"its compression is {compression!r}, and zstd, lz4 or none can be read")
