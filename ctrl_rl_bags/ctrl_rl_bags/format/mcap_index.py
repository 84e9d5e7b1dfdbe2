"""Index of an MCAP file: topics, chunks and counts, from the summary or else from a scan of the file."""

from __future__ import annotations

import math
import struct
import zlib
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import BinaryIO, cast

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, MetadataIndex, Schema, Statistics

from ctrl_rl_bags.format.checks import DamagedError
from ctrl_rl_bags.format.mcap_records import (
    MAGIC,
    READ_AT_ONCE,
    RECORD,
    Limits,
    Parsed,
    chunk_head,
    decompress,
    index_messages,
    message_head,
    parse,
    read_exactly,
    records_in,
)
from ctrl_rl_bags.format.metadata import CUSTOM_DATA_RECORD

_FOOTER = struct.Struct("<BQQQI")
_CHUNK_INDEX = struct.Struct("<QQQQI")
_TOPICS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)
_ALL = frozenset(range(1 << 16))
_MOST_CHANNEL_SETS = 1_000_000
_CHUNK = np.dtype([(name, "<u8") for name in ("start", "end", "offset", "length", "size")])


class McapIndex:
    """Topics, chunks and counts of an open MCAP file.

    Attributes:
        schemas: Schemas by id.
        channels: Channels by id.
        counts: Number of messages by channel.
        start: First log time [ns]; 0 without messages.
        end: Last log time [ns].
        custom_data: Custom data of the bag, by key.
        chunks: Log times [ns], offset, and size on disk and in memory [bytes] of each chunk (n,).
        chunk_channels: Channels of each chunk's messages; None if not in the index.
        loose: Whether messages lie outside of chunks.
        summary_crc: Checksum of the summary; 0 without one.

    Raises:
        DamagedError: The file is not a complete MCAP file, a checksum is wrong, or a limit is exceeded.
    """

    def __init__(self, stream: BinaryIO, size: int, limits: Limits) -> None:
        """Read the index.

        Args:
            stream: File, positioned at its first byte.
            size: Size of the file [bytes].
            limits: Memory limits.
        """
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: Mapping[int, int] = {}
        self.start = self.end = 0
        self.custom_data: dict[str, str] = {}
        self.chunk_channels: list[frozenset[int] | None] = []
        self.loose = False
        self.summary_crc = 0
        self._stream, self._size, self._limits = stream, size, limits
        self._channel_sets: dict[frozenset[int], frozenset[int]] = {}
        self._channel_set_items = 0
        self._topics_bytes = 0
        self._chunks = array("Q")
        self._open()
        self.chunks = np.frombuffer(self._chunks, _CHUNK)

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return sum(self.counts.values())

    def _open(self) -> None:
        if self._stream.read(len(MAGIC)) != MAGIC:
            raise DamagedError("it is not an MCAP file" if self._size else "it is empty")
        self._read_header()
        self._footer_at = self._size - len(MAGIC) - _FOOTER.size
        if self._footer_at < self._data_at:
            raise DamagedError("it was cut off")
        self._stream.seek(self._footer_at)
        tail = self._stream.read()
        opcode, length, start, _, self.summary_crc = _FOOTER.unpack_from(tail)
        if tail[_FOOTER.size :] != MAGIC or (opcode, length) != (Opcode.FOOTER, 20):
            raise DamagedError("it was cut off")
        if start and not self._data_at <= start <= self._footer_at:
            raise DamagedError("its summary is outside the file")
        self._summary_at = start or self._footer_at
        if not (start and self._read_summary(tail[: _FOOTER.size - 4])):
            self._scan()

    def _read_header(self) -> None:
        opcode, length = RECORD.unpack(read_exactly(self._stream, RECORD.size, RECORD.size))
        content = read_exactly(self._stream, length, self._limits.topics_bytes)
        if opcode != Opcode.HEADER or len(content) < 4:
            raise DamagedError("it has no header")
        profile = content[4 : 4 + int.from_bytes(content[:4], "little")]
        if profile != b"ros2":
            raise DamagedError(f"it is not of ROS 2: its profile is {profile[:40].decode(errors='replace')!r}")
        self._data_at = self._stream.tell()

    def _read_summary(self, footer: bytes) -> bool:
        """Read topics and chunks; return False if the summary is incomplete."""
        self._stream.seek(self._summary_at)
        summary = read_exactly(self._stream, self._footer_at - self._summary_at, self._limits.index_bytes)
        if self.summary_crc and zlib.crc32(footer, zlib.crc32(summary)) != self.summary_crc:
            raise DamagedError("the checksum of its summary is wrong")
        statistics, texts = None, list[MetadataIndex]()
        for opcode, at, length in records_in(summary):
            if opcode == Opcode.CHUNK_INDEX:
                self._add_chunk_index(summary, at, length)
                continue
            record = parse(opcode, summary[at : at + length])
            if isinstance(record, Statistics):
                statistics = record
            elif isinstance(record, MetadataIndex):
                texts += [record] if record.name == CUSTOM_DATA_RECORD else []
            elif record is not None:
                self._add_topic(record, length)
        if statistics is None:
            return False
        self.counts = statistics.channel_message_counts
        self.start, self.end = statistics.message_start_time, statistics.message_end_time
        count = statistics.message_count
        if count and not (self.channels and self._chunks and self.message_count == count):
            return False
        if not self.counts.keys() <= self.channels.keys():
            raise DamagedError("its summary counts messages of an unknown channel")
        chunks = np.sort(np.frombuffer(self._chunks, _CHUNK), order="offset")
        if np.any(chunks["offset"][:-1] + chunks["length"][:-1] > chunks["offset"][1:]):
            raise DamagedError("its index has a chunk twice")
        for text in texts:
            self._read_metadata(text)
        return True

    def _read_metadata(self, index: MetadataIndex) -> None:
        self._stream.seek(min(index.offset, self._size))
        opcode, size = RECORD.unpack(read_exactly(self._stream, RECORD.size, RECORD.size))
        if opcode != Opcode.METADATA or size + RECORD.size != index.length:
            raise DamagedError("its index refers to missing metadata")
        record = parse(opcode, read_exactly(self._stream, size, self._limits.topics_bytes))
        assert record is not None
        self._add_topic(record, size)

    def _add_chunk_index(self, summary: bytes, at: int, length: int) -> None:
        """Add a chunk's times, offset and size, parsed by hand because mcap's own parser takes twice as long."""
        try:
            start, end, offset, size_of_record, size = _CHUNK_INDEX.unpack_from(summary, at)
            tail = at + _CHUNK_INDEX.size + size
            channels = frozenset(channel for channel, _ in struct.iter_unpack("<HQ", summary[tail - size : tail]))
            _, name_size = struct.unpack_from("<QI", summary, tail)
            _, uncompressed = struct.unpack_from("<QQ", summary, tail + 12 + name_size)
        except struct.error:
            raise DamagedError("its index of chunks cannot be read") from None
        if tail + 28 + name_size > at + length:
            raise DamagedError("its index of chunks cannot be read")
        if offset < self._data_at or offset + size_of_record > self._summary_at or start > end:
            raise DamagedError("its index has a chunk outside the file")
        self._chunks.extend((start, end, offset, size_of_record, uncompressed))
        self.chunk_channels.append(self._same(channels) if channels else None)

    def _same(self, channels: frozenset[int]) -> frozenset[int] | None:
        """Return one shared object for equal sets; None, which means any channel, after too many sets."""
        if channels not in self._channel_sets:
            self._channel_set_items += len(channels)
            if self._channel_set_items > _MOST_CHANNEL_SETS:
                return None
            self._channel_sets[channels] = channels
        return self._channel_sets[channels]

    def _add_topic(self, record: Parsed, size: int) -> None:
        """Store a schema, a channel or custom data of some size [bytes]; ignore other records."""
        self._topics_bytes += size
        if self._topics_bytes > self._limits.topics_bytes:
            raise DamagedError(f"its topics take more than {self._limits.topics_bytes:,} bytes")
        if isinstance(record, Metadata):
            if record.name == CUSTOM_DATA_RECORD:
                self.custom_data.update(record.metadata)
        elif isinstance(record, Schema | Channel):
            known = cast("dict[int, Schema | Channel]", self.schemas if isinstance(record, Schema) else self.channels)
            if known.setdefault(record.id, record) != record:
                raise DamagedError(f"it has two {type(record).__name__.lower()}s with the number {record.id}")

    def _scan(self) -> None:
        """Collect topics and chunks by reading the whole file."""
        counts: Counter[int] = Counter()
        first, last = math.inf, 0
        self.schemas, self.channels, self._topics_bytes = {}, {}, 0
        self._chunks, self.chunk_channels = array("Q"), []
        for opcode, content in self.data_section():
            if opcode == Opcode.MESSAGE:
                self.loose = True
                channel, _, time, _ = message_head(content)
                counts[channel] += 1
                first, last = min(first, time), max(last, time)
            elif opcode == Opcode.CHUNK:
                head, inside = chunk_head(content), decompress(content, self._limits.chunk_bytes)
                for kind, at, length in records_in(inside):
                    if kind in _TOPICS and (record := parse(kind, inside[at : at + length])) is not None:
                        self._add_topic(record, length)
                channels, times, _ = index_messages(inside, _ALL, head.start, head.end)
                length = RECORD.size + len(content)
                self._chunks.extend((head.start, head.end, self._stream.tell() - length, length, head.size))
                self.chunk_channels.append(self._same(frozenset(channels)) if times else frozenset())
                counts.update(channels)
                first, last = min([first, *times]), max([last, *times])
            elif opcode in _TOPICS and (record := parse(opcode, content)) is not None:
                self._add_topic(record, len(content))
        if self.loose and self._chunks:
            raise DamagedError("it has messages in chunks and outside of them, and no summary")
        if not counts.keys() <= self.channels.keys():
            raise DamagedError("it has a message of an unknown channel")
        self.counts, self.start, self.end = dict(counts), int(first) if counts else 0, last

    def data_section(self) -> Iterator[tuple[int, bytes]]:
        """Yield all records before the summary, unneeded ones with empty content; verify the data checksum."""
        self._stream.seek(0)
        crc = zlib.crc32(self._stream.read(self._data_at))
        position = self._data_at
        while position + RECORD.size <= self._summary_at:
            head = read_exactly(self._stream, RECORD.size, RECORD.size)
            opcode, length = RECORD.unpack(head)
            if position + RECORD.size + length > self._summary_at:
                raise DamagedError("a record reaches beyond its part of the file")
            if opcode == Opcode.DATA_END:
                said = int.from_bytes(self._stream.read(4), "little")
                if said and said != crc:
                    raise DamagedError("the checksum of its data is wrong")
                return
            crc = zlib.crc32(head, crc)
            content = b""
            if opcode in (Opcode.CHUNK, Opcode.MESSAGE, *_TOPICS):
                content = read_exactly(self._stream, length, self._limits.chunk_bytes + READ_AT_ONCE)
                crc = zlib.crc32(content, crc)
            else:
                for left in range(length, 0, -READ_AT_ONCE):
                    crc = zlib.crc32(read_exactly(self._stream, min(left, READ_AT_ONCE), READ_AT_ONCE), crc)
            position = self._stream.tell()
            yield opcode, content
        raise DamagedError("the end of its data is missing")
