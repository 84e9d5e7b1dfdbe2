"""The chunks of an MCAP file: where they are, and their messages in the order of log time."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from ctrl_rl_bags.format.checks import DamagedError
from ctrl_rl_bags.format.mcap_records import MESSAGE, RECORD

_MESSAGE_RECORD = struct.Struct("<BQHIQQ")
_MESSAGE_OPCODE = int(Opcode.MESSAGE)


class McapMessage(NamedTuple):
    """One message: number of its channel, the publisher's count, times [ns], bytes as on the wire."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


@dataclass
class ChunkTable:
    """Times [ns], place and size of each chunk of a file: one entry of each list for each chunk."""

    start: array[int] = field(default_factory=lambda: array("Q"))
    end: array[int] = field(default_factory=lambda: array("Q"))
    offset: array[int] = field(default_factory=lambda: array("Q"))
    length: array[int] = field(default_factory=lambda: array("Q"))
    size: array[int] = field(default_factory=lambda: array("Q"))
    channels: list[frozenset[int] | None] = field(default_factory=list)
    """Channels of its messages; None where the index does not name them."""

    def add(self, start: int, end: int, offset: int, length: int, size: int, channels: frozenset[int] | None) -> None:
        """Append a chunk."""
        for column, value in zip(
            (self.start, self.end, self.offset, self.length, self.size), (start, end, offset, length, size), strict=True
        ):
            column.append(value)
        self.channels.append(channels)

    def __len__(self) -> int:
        return len(self.start)


@dataclass
class OpenChunk:
    """The records of a chunk, with log time and place of its messages in the order of time.

    Attributes:
        records: Content of the chunk, decompressed.
        times: Log time of each message [ns], rising.
        places: Offset of each message's record in `records`.
        size: Bytes of memory that the chunk counts for.
        next: Index of the next message to read.
    """

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


def drain(waiting: list[tuple[int, int, OpenChunk]], stop: int) -> Generator[McapMessage, None, int]:
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


def index_messages(
    records: bytes, chosen: frozenset[int], first: int, last: int
) -> tuple[array[int], array[int], array[int]]:
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


def message_head(content: bytes) -> tuple[int, int, int, int]:
    """Return channel, sequence, log time and publication time of a message record's content."""
    if len(content) < MESSAGE.size:
        raise DamagedError("a message is too short")
    channel, sequence, log_time, publish_time = MESSAGE.unpack_from(content)
    return channel, sequence, log_time, publish_time


def records_in(data: bytes) -> Iterator[tuple[int, int, int]]:
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
