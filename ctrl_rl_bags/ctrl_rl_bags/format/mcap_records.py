"""Records and chunks of possibly hostile MCAP files; every size is checked before the content is read.

See https://mcap.dev/spec for the layouts.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, MetadataIndex, Schema, Statistics

from ctrl_rl_bags.format.checks import DamagedError, LargeChunkError

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
MESSAGE = struct.Struct("<HIQQ")
OPCODES = {int(opcode) for opcode in Opcode}
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
_CHUNK = struct.Struct("<QQQI")
READ_AT_ONCE = 1 << 20
"""Block size for reading records that are only skipped or checked [bytes]."""
_LONGEST_COMPRESSION = 32
Parsed = Schema | Channel | Metadata | MetadataIndex | Statistics
_KINDS: dict[int, type[Parsed]] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.STATISTICS: Statistics,
}
_ZSTD = zstandard.ZstdDecompressor()
_MIB = 1 << 20
_BROKEN = (McapError, struct.error, ValueError, zstandard.ZstdError, RuntimeError, MemoryError)


@dataclass(frozen=True)
class Limits:
    """Memory limits for reading a bag [bytes].

    Attributes:
        chunk_bytes: Uncompressed size of a chunk, and size of a message.
        open_bytes: Total uncompressed size of chunks with overlapping times.
        index_bytes: Size of a file's summary.
        topics_bytes: Total size of all schemas, channels and metadata records of a file.
    """

    chunk_bytes: int = 128 * _MIB
    open_bytes: int = 256 * _MIB
    index_bytes: int = 128 * _MIB
    topics_bytes: int = 16 * _MIB


DEFAULT_LIMITS = Limits()


class ChunkHead(NamedTuple):
    """Header of a chunk record: log times [ns], sizes [bytes], checksum (0: none), compression."""

    start: int
    end: int
    size: int
    crc: int
    compression: str
    data_at: int


def read_exactly(stream: BinaryIO, size: int, limit: int) -> bytes:
    """Read an exact number of bytes from a file.

    Raises:
        DamagedError: The file ends early, or `size` exceeds the limit.
    """
    if size > limit:
        raise DamagedError(f"a record of {size:,} bytes, where at most {limit:,} are read")
    data = stream.read(size)
    if len(data) != size:
        raise DamagedError("a record reaches beyond the end of the file")
    return data


def parse(opcode: int, content: bytes) -> Parsed | None:
    """Parse a record; return None for kinds that are not needed.

    Raises:
        DamagedError: The content cannot be parsed.
    """
    kind = _KINDS.get(opcode)
    try:
        return None if kind is None else kind.read(ReadDataStream(BytesIO(content)))
    except _BROKEN as error:
        raise DamagedError(f"a {Opcode(opcode).name.lower()} record cannot be read ({type(error).__name__})") from None


def chunk_head(content: bytes, whole: bool = True) -> ChunkHead:
    """Parse the header of a chunk record.

    Args:
        content: Content of the chunk record.
        whole: Whether the chunk must be complete, with data of the stated length.

    Raises:
        DamagedError: The chunk is too short, or its data has another length.
    """
    try:
        start, end, size, crc = _CHUNK.unpack_from(content)
        (length,) = struct.unpack_from("<I", content, _CHUNK.size)
        name_at = _CHUNK.size + 4
        if length > _LONGEST_COMPRESSION:
            raise ValueError
        name = bytes(content[name_at : name_at + length]).decode()
        (data_size,) = struct.unpack_from("<Q", content, name_at + length)
    except (struct.error, ValueError):
        raise DamagedError("a chunk's header cannot be read") from None
    data_at = name_at + length + 8
    if whole and data_size != len(content) - data_at:
        raise DamagedError("a chunk's data length contradicts its header")
    return ChunkHead(start, end, size, crc, name, data_at)


def decompress(content: bytes, limit: int) -> bytes:
    """Decompress the records of a complete chunk.

    Raises:
        DamagedError: The chunk exceeds the limit, cannot be decompressed, or contradicts its size or checksum.
    """
    head = chunk_head(content)
    if head.size > limit:
        raise LargeChunkError(head.size, limit)
    records = decompress_some(head.compression, content[head.data_at :], head.size)
    if len(records) != head.size:
        raise DamagedError("a chunk's size contradicts its header")
    if head.crc and zlib.crc32(records) != head.crc:
        raise DamagedError("a chunk's checksum is wrong")
    return records


def decompress_some(compression: str, data: bytes, size: int) -> bytes:
    """Decompress at most `size + 1` bytes; of truncated data, as much as possible.

    Raises:
        DamagedError: The data is corrupt, or the compression is unknown.
    """
    try:
        if compression == "zstd":
            if zstandard.get_frame_parameters(data).content_size == size:
                return _ZSTD.decompress(data)
            # Without a maximum size, `decompress` has no limit: 130 kB may expand to 4 GB.
            with _ZSTD.stream_reader(data, read_across_frames=True) as reader:
                return reader.read(size + 1)
        if compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    except _BROKEN:
        raise DamagedError("a chunk cannot be decompressed") from None
    if compression:
        raise DamagedError(f"a chunk's compression {compression!r} is unknown")
    return data


def index_messages(
    records: bytes, chosen: frozenset[int], first: int, last: int
) -> tuple[array[int], array[int], array[int]]:
    """Return channel, log time and offset of each selected message of a chunk, in file order."""
    channels, times, places = array("H"), array("Q"), array("Q")
    for opcode, at, length in records_in(records):
        if opcode == _MESSAGE_OPCODE:
            if length < MESSAGE.size:
                raise DamagedError("a record does not fit into its chunk")
            channel, _, time, _ = MESSAGE.unpack_from(records, at)
            if channel in chosen:
                if not first <= time <= last:
                    raise DamagedError("a chunk has a message outside of its time range")
                channels.append(channel)
                times.append(time)
                places.append(at)
    return channels, times, places


def message_head(content: bytes) -> tuple[int, int, int, int]:
    """Return channel, sequence, log time and publication time of a message record's content."""
    if len(content) < MESSAGE.size:
        raise DamagedError("a message is too short")
    channel, sequence, log_time, publish_time = MESSAGE.unpack_from(content)
    return channel, sequence, log_time, publish_time


def records_in(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, offset and length of each record's content."""
    at, size = 0, len(data)
    while at < size:
        if at + RECORD.size > size:
            raise DamagedError("a record is cut off")
        opcode, length = RECORD.unpack_from(data, at)
        at += RECORD.size
        if at + length > size:
            raise DamagedError("a record reaches beyond its part of the file")
        yield opcode, at, length
        at += length
