"""Reads one MCAP file in the order of its log time, within bounds, and checks each checksum of what it reads.

A file's summary says which topics and chunks there are. A file without one is scanned for them.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections import Counter
from collections.abc import Collection, Generator, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from heapq import heappop, heappush
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from ctrl_rl_bags.format.checks import DamagedError, open_regular
from ctrl_rl_bags.format.mcap_records import (
    DEFAULT_LIMITS,
    MAGIC,
    MESSAGE,
    RECORD,
    Limits,
    chunk_head,
    decompress,
    parse,
    read_exactly,
)
from ctrl_rl_bags.format.metadata import CUSTOM_DATA_RECORD

_FOOTER = struct.Struct("<BQQQI")
_CHUNK_INDEX = struct.Struct("<QQQQI")
_MESSAGE_RECORD = struct.Struct("<BQHIQQ")
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
_ALL = frozenset(range(1 << 16))
_STATISTICS = struct.Struct("<QHIIIIQQI")
_MOST_CHANNEL_SETS = 1_000_000
_READ_AT_ONCE = 1 << 20


class McapMessage(NamedTuple):
    """One message: number of its channel, the publisher's count, times [ns], bytes as on the wire."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


@dataclass
class _Chunks:
    """Where the chunks of a file are: one entry of each list for each chunk."""

    start: array[int] = field(default_factory=lambda: array("Q"))
    end: array[int] = field(default_factory=lambda: array("Q"))
    offset: array[int] = field(default_factory=lambda: array("Q"))
    length: array[int] = field(default_factory=lambda: array("Q"))
    size: array[int] = field(default_factory=lambda: array("Q"))
    channels: list[frozenset[int] | None] = field(default_factory=list)
    """Channels of its messages; None where the index does not say."""

    def add(self, start: int, end: int, offset: int, length: int, size: int, channels: frozenset[int] | None) -> None:
        for column, value in zip(
            (self.start, self.end, self.offset, self.length, self.size), (start, end, offset, length, size), strict=True
        ):
            column.append(value)
        self.channels.append(channels)

    def __len__(self) -> int:
        return len(self.start)


class McapReader:
    """One MCAP file, open until `close`.

    Attributes:
        schemas: Schemas by number.
        channels: Channels by number.
        counts: Number of messages by channel.
        start: First log time [ns]; 0 without messages.
        end: Last log time [ns].
        custom_data: Texts that the bag keeps.

    Raises:
        DamagedError: it is no whole MCAP file, a checksum is wrong, or it asks for more than the limits allow.
        OSError: it cannot be read.
    """

    def __init__(self, path: Path, limits: Limits = DEFAULT_LIMITS) -> None:
        self.path = path
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: Mapping[int, int] = {}
        self.start = self.end = 0
        self.custom_data: dict[str, str] = {}
        self._limits = limits
        self._chunks = _Chunks()
        self._channel_sets: dict[frozenset[int], frozenset[int]] = {}
        self._channel_set_items = 0
        self._topics_bytes = 0
        self._loose = False
        self._stack = ExitStack()
        try:
            self._stream, self._size = self._stack.enter_context(open_regular(path))
            self._open()
        except BaseException:
            self.close()
            raise

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return sum(self.counts.values())

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def messages(
        self, channels: Collection[int] | None = None, start: int | None = None, stop: int | None = None
    ) -> Iterator[McapMessage]:
        """Yield messages in the order of their log time.

        Args:
            channels: Numbers of the channels to read; None for all.
            start: First log time [ns], included.
            stop: Last log time [ns], excluded.

        Raises:
            DamagedError: a chunk or a message is damaged, or some are missing.
        """
        chosen = frozenset(self.channels if channels is None else channels)
        first, last = start or 0, (1 << 64) - 1 if stop is None else stop - 1
        left = Counter({channel: self.counts.get(channel, 0) for channel in chosen})
        for message in self._loose_messages(chosen) if self._loose else self._merged(chosen, first, last):
            if first <= message.log_time <= last:
                left[message.channel] -= 1
                yield message
        if start is None and stop is None and any(left.values()):
            raise DamagedError("it does not hold as many messages as it says")

    def check_data(self) -> None:
        """Read the file once, and check all of it that precedes the summary.

        Raises:
            DamagedError: the checksum is wrong, or a record is damaged.
        """
        for _ in self._data_section():
            pass

    def checksums(self) -> tuple[bool, bool]:
        """Return whether the summary has a checksum, and whether all messages have one."""
        return self._summary_crc != 0, not self._loose and all(self._crc_of(offset) for offset in self._chunks.offset)

    def _crc_of(self, chunk: int) -> int:
        self._stream.seek(chunk + RECORD.size + 24)
        return int.from_bytes(read_exactly(self._stream, 4, 4), "little")

    def _open(self) -> None:
        if self._stream.read(len(MAGIC)) != MAGIC:
            raise DamagedError("it is no MCAP file" if self._size else "it is empty")
        self._read_header()
        self._footer_at = self._size - len(MAGIC) - _FOOTER.size
        if self._footer_at < self._data_at:
            raise DamagedError("it was cut off")
        self._stream.seek(self._footer_at)
        tail = self._stream.read()
        opcode, length, start, _, self._summary_crc = _FOOTER.unpack_from(tail)
        if tail[_FOOTER.size :] != MAGIC or (opcode, length) != (Opcode.FOOTER, 20):
            raise DamagedError("it was cut off")
        if start and not self._data_at <= start <= self._footer_at:
            raise DamagedError("its summary does not lie in it")
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
        """Read topics and chunks, and return whether the summary names them all."""
        self._stream.seek(self._summary_at)
        summary = read_exactly(self._stream, self._footer_at - self._summary_at, self._limits.index_bytes)
        if self._summary_crc and zlib.crc32(footer, zlib.crc32(summary)) != self._summary_crc:
            raise DamagedError("the checksum of its summary is wrong")
        count, texts = None, []
        try:
            for opcode, at, length in _records_in(summary):
                if opcode == Opcode.CHUNK_INDEX:
                    self._add_chunk_index(summary, at, length)
                elif opcode == Opcode.STATISTICS:
                    count, _, _, _, _, _, self.start, self.end, size = _STATISTICS.unpack_from(summary, at)
                    pairs = summary[at + _STATISTICS.size : at + _STATISTICS.size + size]
                    self.counts = dict(struct.iter_unpack("<HQ", pairs))
                elif opcode == Opcode.METADATA_INDEX:
                    offset, size, name = struct.unpack_from("<QQI", summary, at)
                    if summary[at + 20 : at + 20 + name] == CUSTOM_DATA_RECORD.encode():
                        texts.append((offset, size))
                else:
                    self._add_topic(opcode, summary[at : at + length])
        except struct.error:
            raise DamagedError("its summary cannot be read") from None
        if count is None or (count and not (self.channels and len(self._chunks) and self.message_count == count)):
            return False
        if not self.counts.keys() <= self.channels.keys():
            raise DamagedError("its summary counts messages of an unknown channel")
        offsets, lengths = (np.array(column, np.uint64) for column in (self._chunks.offset, self._chunks.length))
        order = np.argsort(offsets)
        if np.any(offsets[order][:-1] + lengths[order][:-1] > offsets[order][1:]):
            raise DamagedError("its index has a chunk twice")
        for offset, size in texts:
            self._read_metadata(offset, size)
        return True

    def _read_metadata(self, offset: int, length: int) -> None:
        self._stream.seek(min(offset, self._size))
        opcode, size = RECORD.unpack(read_exactly(self._stream, RECORD.size, RECORD.size))
        if opcode != Opcode.METADATA or size + RECORD.size != length:
            raise DamagedError("its index has metadata where there is none")
        self._add_topic(opcode, read_exactly(self._stream, size, self._limits.topics_bytes))

    def _add_chunk_index(self, summary: bytes, at: int, length: int) -> None:
        start, end, offset, size_of_record, size = _CHUNK_INDEX.unpack_from(summary, at)
        at, stop = at + _CHUNK_INDEX.size, at + length
        pairs, at = summary[at : at + size], at + size
        (name_size,) = struct.unpack_from("<QI", summary, at)[1:]
        _, uncompressed = struct.unpack_from("<QQ", summary, at + 12 + name_size)
        if at + 28 + name_size > stop or len(pairs) != size:
            raise DamagedError("its index of chunks cannot be read")
        if offset < self._data_at or offset + size_of_record > self._summary_at or start > end:
            raise DamagedError("its index has a chunk that does not lie in it")
        channels = frozenset(channel for channel, _ in struct.iter_unpack("<HQ", pairs))
        self._chunks.add(start, end, offset, size_of_record, uncompressed, self._same(channels) if channels else None)

    def _same(self, channels: frozenset[int]) -> frozenset[int] | None:
        """Return the one object that stands for equal sets; None, for any channel, when there are too many of them."""
        if channels not in self._channel_sets:
            self._channel_set_items += len(channels)
            if self._channel_set_items > _MOST_CHANNEL_SETS:
                return None
            self._channel_sets[channels] = channels
        return self._channel_sets[channels]

    def _add_topic(self, opcode: int, content: bytes) -> None:
        """Take a schema, a channel or custom data; nothing of any other record."""
        record = parse(opcode, content)
        if record is None:
            return
        self._topics_bytes += len(content)
        if self._topics_bytes > self._limits.topics_bytes:
            raise DamagedError(f"its topics take more than {self._limits.topics_bytes:,} bytes")
        if isinstance(record, Metadata):
            if record.name == CUSTOM_DATA_RECORD:
                self.custom_data.update(record.metadata)
            return
        known = cast("dict[int, Schema | Channel]", self.schemas if isinstance(record, Schema) else self.channels)
        if known.setdefault(record.id, record) != record:
            raise DamagedError(f"it has two {type(record).__name__.lower()}s with the number {record.id}")

    def _scan(self) -> None:
        """Find topics and chunks where there is no summary."""
        counts: Counter[int] = Counter()
        first, last = list[int](), list[int]()
        self.schemas, self.channels, self._chunks, self._topics_bytes = {}, {}, _Chunks(), 0
        for opcode, content in self._data_section():
            if opcode == Opcode.MESSAGE:
                self._loose = True
                channel, _, time, _ = _message_head(content)
                counts[channel] += 1
                first, last = [min([*first, time])], [max([*last, time])]
            elif opcode == Opcode.CHUNK:
                head, inside = chunk_head(content), decompress(content, self._limits.chunk_bytes)
                for kind, at, length in _records_in(inside):
                    if kind != Opcode.MESSAGE:
                        self._add_topic(kind, inside[at : at + length])
                channels, times, _ = _index(inside, _ALL, head.start, head.end)
                length = RECORD.size + len(content)
                offset = self._stream.tell() - length
                found = self._same(frozenset(channels)) if times else frozenset()
                self._chunks.add(head.start, head.end, offset, length, head.size, found)
                counts.update(channels)
                if times:
                    first, last = [min([*first, *times])], [max([*last, *times])]
            else:
                self._add_topic(opcode, content)
        if self._loose and len(self._chunks):
            raise DamagedError("it has messages in chunks and outside of them, and no summary")
        if not counts.keys() <= self.channels.keys():
            raise DamagedError("it has a message of an unknown channel")
        self.counts, self.start, self.end = dict(counts), *(first or [0]), *(last or [0])

    def _data_section(self) -> Iterator[tuple[int, bytes]]:
        """Yield all records before the summary; what is not needed, empty."""
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
            if opcode in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
                content = read_exactly(self._stream, length, self._limits.chunk_bytes + _READ_AT_ONCE)
                crc = zlib.crc32(content, crc)
            else:
                for size in _pieces(length):
                    crc = zlib.crc32(read_exactly(self._stream, size, _READ_AT_ONCE), crc)
            position = self._stream.tell()
            yield opcode, content
        raise DamagedError("the end of its data is missing")

    def _loose_messages(self, chosen: frozenset[int]) -> Iterator[McapMessage]:
        before = 0
        for opcode, content in self._data_section():
            if opcode == Opcode.MESSAGE:
                head = _message_head(content)
                if head[2] < before:
                    raise DamagedError("its messages are not in the order of their log time, and it has no index")
                before = head[2]
                if head[0] in chosen:
                    yield McapMessage(*head, content[MESSAGE.size :])

    def _merged(self, chosen: frozenset[int], first: int, last: int) -> Iterator[McapMessage]:
        """Yield messages of all chunks in the order of their log time; no chunk is opened before its time."""
        chunks, waiting, opened = self._chunks, list[tuple[int, int, _Cursor]](), 0
        for number in np.argsort(np.frombuffer(chunks.start, np.uint64), kind="stable").tolist():
            channels, start = chunks.channels[number], chunks.start[number]
            if chunks.end[number] < first or start > last or not (channels is None or channels & chosen):
                continue
            opened -= yield from _drain(waiting, start)
            opened += chunks.size[number]
            if waiting and opened > self._limits.open_bytes:
                raise DamagedError(
                    f"its chunks overlap: {opened:,} bytes at {start} ns, at most {self._limits.open_bytes:,}"
                )
            cursor = self._open_chunk(number, chosen)
            if cursor.times:
                heappush(waiting, (cursor.times[0], number, cursor))
            else:
                opened -= cursor.size
        yield from _drain(waiting, 1 << 64)

    def _open_chunk(self, number: int, chosen: frozenset[int]) -> _Cursor:
        chunks = self._chunks
        self._stream.seek(chunks.offset[number])
        opcode, length = RECORD.unpack(read_exactly(self._stream, RECORD.size, RECORD.size))
        if opcode != Opcode.CHUNK or RECORD.size + length != chunks.length[number]:
            raise DamagedError("its index has a chunk where there is none")
        content = read_exactly(self._stream, length, self._limits.chunk_bytes + _READ_AT_ONCE)
        head = chunk_head(content)
        if (head.start, head.end, head.size) != (chunks.start[number], chunks.end[number], chunks.size[number]):
            raise DamagedError("a chunk is not what the index says")
        records = decompress(content, self._limits.chunk_bytes)
        _, times, places = _index(records, chosen, head.start, head.end)
        return _Cursor(records, times, places, chunks.size[number])


@dataclass
class _Cursor:
    """An open chunk: its records, log time and place of its messages in the order of time, and which comes next."""

    records: bytes
    times: array[int]
    places: array[int]
    size: int
    next: int = 0

    def __post_init__(self) -> None:
        times = np.frombuffer(self.times, np.uint64)
        if len(times) > 1 and np.any(times[1:] < times[:-1]):
            order = np.argsort(times, kind="stable")
            self.places = array("Q", np.frombuffer(self.places, np.uint64)[order].tobytes())
            self.times = array("Q", times[order].tobytes())


def _drain(waiting: list[tuple[int, int, _Cursor]], stop: int) -> Generator[McapMessage, None, int]:
    """Yield the messages of open chunks that are older than `stop`; return the size of those that are empty now."""
    freed = 0
    while waiting and waiting[0][0] < stop:
        _, number, cursor = heappop(waiting)
        until = min(stop, waiting[0][0] + 1) if waiting else stop
        records, times, places = cursor.records, cursor.times, cursor.places
        at, count = cursor.next, len(times)
        while at < count and times[at] < until:
            place = places[at]
            _, length, channel, sequence, log_time, publish_time = _MESSAGE_RECORD.unpack_from(records, place)
            data = records[place + _MESSAGE_RECORD.size : place + RECORD.size + length]
            yield McapMessage(channel, sequence, log_time, publish_time, data)
            at += 1
        cursor.next = at
        if at < count:
            heappush(waiting, (times[at], number, cursor))
        else:
            freed += cursor.size
    return freed


def _index(records: bytes, chosen: frozenset[int], first: int, last: int) -> tuple[array[int], array[int], array[int]]:
    """Return channel, log time and place of each chosen message of a chunk, in the order of the file."""
    channels, times, places = array("H"), array("Q"), array("Q")
    at, size = 0, len(records)
    while at < size:
        if at + RECORD.size > size:
            raise DamagedError("a record is cut off")
        opcode, length = RECORD.unpack_from(records, at)
        after = at + RECORD.size + length
        if after > size or (opcode == _MESSAGE_OPCODE and length < MESSAGE.size):
            raise DamagedError("a record does not fit into its chunk")
        if opcode == _MESSAGE_OPCODE:
            channel, _, time, _ = MESSAGE.unpack_from(records, at + RECORD.size)
            if channel in chosen:
                if not first <= time <= last:
                    raise DamagedError("a chunk has a message outside of its times")
                channels.append(channel)
                times.append(time)
                places.append(at)
        at = after
    return channels, times, places


def _message_head(content: bytes) -> tuple[int, int, int, int]:
    if len(content) < MESSAGE.size:
        raise DamagedError("a message is too short")
    channel, sequence, log_time, publish_time = MESSAGE.unpack_from(content)
    return channel, sequence, log_time, publish_time


def _records_in(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, place and length of each record's content."""
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


def _pieces(size: int) -> Iterator[int]:
    while size:
        yield min(size, _READ_AT_ONCE)
        size -= min(size, _READ_AT_ONCE)
