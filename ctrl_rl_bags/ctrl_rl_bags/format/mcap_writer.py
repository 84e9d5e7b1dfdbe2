"""Writes one MCAP file in small compressed chunks, which reach the operating system on each flush.

All records except the two on the hot path (message, message index) are written by the mcap library. Its own writer
takes 3-6 us of Python per message, with 1 MiB chunks (test/benchmarks/recorder_throughput.py).
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from ctrl_rl_bags.format.metadata import Topic

MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 64 * 1024
COMPRESSION_LEVEL = 1
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
_MESSAGE_HEAD = 2 + 4 + 8 + 8
_INDEX = struct.Struct("<BQHI")


class McapFile:
    """Writes one .mcap file with profile `ros2`. The caller must call `close` or `abort`.

    After an OSError the file is truncated to its last complete record; `close` may still succeed.
    """

    def __init__(self, path: Path, chunk_bytes: int = CHUNK_BYTES) -> None:
        self.path = path
        self.size = 0
        self.start: int | None = None
        self.end: int | None = None
        self._chunk_bytes = chunk_bytes
        self._compressor = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL)
        self._chunk = bytearray()
        self._indexes: defaultdict[int, list[int]] = defaultdict(list)
        self._schemas: dict[str, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: defaultdict[int, int] = defaultdict(int)
        self._chunk_indexes = bytearray()
        self._chunk_count = 0
        self._metadata_indexes: list[MetadataIndex] = []
        self._crc = 0
        self._file = path.open("xb", buffering=0)
        self._append(MAGIC + _bytes(Header("ros2", "ctrl_rl_core")))

    @property
    def message_count(self) -> int:
        """Number of messages in complete chunks, visible to readers of the file."""
        return sum(self._counts.values())

    @property
    def message_counts(self) -> dict[str, int]:
        """Number of messages in complete chunks, by topic."""
        return {self._channels[channel].topic: count for channel, count in self._counts.items()}

    def add_topic(self, topic: Topic) -> int:
        """Write a topic's schema and channel; return the channel id for `write`."""
        records = b""
        if topic.type not in self._schemas:
            schema = Schema(
                id=len(self._schemas) + 1, data=topic.definition.encode(), encoding=topic.encoding, name=topic.type
            )
            self._schemas[topic.type] = schema
            records += _bytes(schema)
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic.name,
            message_encoding="cdr",
            metadata={"offered_qos_profiles": topic.qos_text, "topic_type_hash": topic.type_hash},
            schema_id=self._schemas[topic.type].id,
        )
        self._channels[channel.id] = channel
        self._append(records + _bytes(channel))
        return channel.id

    def write(
        self, channel: int, data: bytes | bytearray | memoryview, log_time: int, publish_time: int, sequence: int
    ) -> None:
        """Add one serialised message to the open chunk; times in ns since the epoch, sequence below 2**32."""
        chunk = self._chunk
        head = _MESSAGE.pack(_MESSAGE_OPCODE, _MESSAGE_HEAD + len(data), channel, sequence, log_time, publish_time)
        self._indexes[channel] += (log_time, len(chunk))
        chunk += head
        chunk += data
        if len(chunk) >= self._chunk_bytes:
            self.flush()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write named key-value pairs."""
        record = _bytes(Metadata(name=name, metadata=dict(values)))
        self._append(record)
        self._metadata_indexes.append(MetadataIndex(offset=self.size - len(record), length=len(record), name=name))

    def flush(self) -> None:
        """Pass the open chunk to the operating system; from then on it survives the death of this process."""
        if not self._indexes:
            return
        raw, indexes = self._chunk, self._indexes
        self._chunk, self._indexes = bytearray(), defaultdict(list)
        times = [time for entries in indexes.values() for time in entries[::2]]
        compressed = self._compressor.compress(raw)
        chunk = Chunk(
            compression="zstd",
            data=compressed,
            message_start_time=min(times),
            message_end_time=max(times),
            uncompressed_crc=zlib.crc32(raw),
            uncompressed_size=len(raw),
        )
        record = _bytes(chunk)
        offset = self.size + len(record)
        index_offsets = {}
        index_records = []
        for channel, entries in indexes.items():
            index_offsets[channel] = offset
            size = 8 * len(entries)
            index_records.append(_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size))
            index_records.append(struct.pack(f"<{len(entries)}Q", *entries))
            offset += _INDEX.size + size
        start = self.size
        self._append(b"".join([record, *index_records]))
        self._chunk_count += 1
        # As bytes: as objects, an hour of recording would take 21 MB.
        self._chunk_indexes += _bytes(
            ChunkIndex(
                chunk_length=len(record),
                chunk_start_offset=start,
                compression="zstd",
                compressed_size=len(compressed),
                message_end_time=chunk.message_end_time,
                message_index_length=self.size - start - len(record),
                message_index_offsets=index_offsets,
                message_start_time=chunk.message_start_time,
                uncompressed_size=len(raw),
            )
        )
        for channel, entries in indexes.items():
            self._counts[channel] += len(entries) // 2
        self.start = chunk.message_start_time if self.start is None else min(self.start, chunk.message_start_time)
        self.end = chunk.message_end_time if self.end is None else max(self.end, chunk.message_end_time)

    def fileno(self) -> int:
        """File descriptor, for fsync."""
        return self._file.fileno()

    def finish(self) -> None:
        """Write the open chunk and the summary, which completes the file; only `close` may follow."""
        self.flush()
        data_end = _bytes(DataEnd(self._crc))
        start = self.size + len(data_end)
        groups = [
            (Opcode.SCHEMA, _all_bytes(self._schemas.values())),
            (Opcode.CHANNEL, _all_bytes(self._channels.values())),
            (Opcode.STATISTICS, _bytes(self._statistics())),
            (Opcode.CHUNK_INDEX, bytes(self._chunk_indexes)),
            (Opcode.METADATA_INDEX, _all_bytes(self._metadata_indexes)),
        ]
        summary, offsets = b"", b""
        for opcode, group in groups:
            if group:
                offsets += _bytes(SummaryOffset(opcode, start + len(summary), len(group)))
                summary += group
        offsets_start = start + len(summary)
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_start)
        crc = zlib.crc32(summary + offsets + footer)
        self._append(data_end + summary + offsets + _bytes(Footer(start, offsets_start, crc)) + MAGIC)

    def close(self) -> None:
        """Flush the file to the disk and close it."""
        try:
            os.fsync(self.fileno())
        finally:
            self._file.close()

    def abort(self) -> None:
        """Close the file without a summary."""
        self._file.close()

    def _append(self, data: bytes) -> None:
        """Write all of `data`, or truncate the file to its previous length and raise OSError."""
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) :]
        except OSError:
            self._file.truncate(self.size)
            self._file.seek(self.size)
            raise
        self.size += len(data)
        self._crc = zlib.crc32(data, self._crc)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunk_count,
            message_count=self.message_count,
            message_end_time=self.end or 0,
            message_start_time=self.start or 0,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _all_bytes(records: Iterable[McapRecord]) -> bytes:
    return b"".join(_bytes(record) for record in records)
