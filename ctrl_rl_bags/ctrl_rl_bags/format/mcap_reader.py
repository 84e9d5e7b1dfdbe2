"""Reads one MCAP file in log-time order, in bounded memory, and verifies all checksums."""

from __future__ import annotations

import struct
from array import array
from collections import Counter
from collections.abc import Collection, Generator, Iterator
from contextlib import ExitStack
from heapq import heappop, heappush, heapreplace
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode

from ctrl_rl_bags.format.checks import DamagedError, open_regular
from ctrl_rl_bags.format.mcap_index import McapIndex
from ctrl_rl_bags.format.mcap_records import (
    MESSAGE,
    READ_AT_ONCE,
    RECORD,
    Limits,
    chunk_head,
    decompress,
    index_messages,
    message_head,
    read_exactly,
)
from ctrl_rl_bags.format.metadata import SerializedMessage, Topic, mcap_topic

_MESSAGE_RECORD = struct.Struct("<BQHIQQ")
_Names = dict[int, tuple[str, str]]
"""Topic and type by channel."""
_Waiting = list[tuple[int, int, SerializedMessage, Iterator[SerializedMessage]]]
"""Open chunks: log time of the next message, chunk index, that message, and an iterator over the rest."""


class McapReader:
    """An MCAP file, open until `close`.

    Attributes:
        topics: Topics with message counts; a topic with two message types appears twice.
        start: First log time [ns]; 0 without messages.
        end: Last log time [ns].
        custom_data: Custom data.

    Raises:
        DamagedError: The file is not a complete MCAP file, a checksum is wrong, or a limit is exceeded.
        OSError: The file cannot be read.
    """

    def __init__(self, path: Path, limits: Limits) -> None:
        self._limits = limits
        self._stack = ExitStack()
        try:
            self._stream, size = self._stack.enter_context(open_regular(path))
            self._index = index = McapIndex(self._stream, size, limits)
            self._topics = {
                number: mcap_topic(channel, index.schemas.get(channel.schema_id))
                for number, channel in index.channels.items()
            }
        except BaseException:
            self.close()
            raise
        self.start, self.end, self.custom_data = index.start, index.end, index.custom_data
        counts: dict[tuple[str, str], tuple[Topic, int]] = {}
        for number, topic in self._topics.items():
            known, count = counts.get((topic.name, topic.type), (topic, 0))
            counts[topic.name, topic.type] = known, count + index.counts.get(number, 0)
        self.topics = list(counts.values())

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def messages(
        self, topics: Collection[str], start: int | None = None, stop: int | None = None
    ) -> Iterator[SerializedMessage]:
        """Yield the messages of some topics in log-time order, from `start` to before `stop` [ns].

        Raises:
            DamagedError: A chunk or a message is damaged or missing.
        """
        names = {number: (topic.name, topic.type) for number, topic in self._topics.items() if topic.name in topics}
        for number, (name, _) in names.items():
            encoding = self._index.channels[number].message_encoding
            if encoding != "cdr":
                raise DamagedError(f"{name} is encoded as {encoding[:40]!r}, not as cdr")
        first, last = start or 0, (1 << 64) - 1 if stop is None else stop - 1
        left = Counter[tuple[str, str]]()
        for number, name_and_type in names.items():
            left[name_and_type] += self._index.counts.get(number, 0)
        for message in self._loose_messages(names) if self._index.loose else self._merged(names, first, last):
            if first <= message.log_time <= last:
                left[message[:2]] -= 1
                yield message
        if start is None and stop is None and any(left.values()):
            raise DamagedError("its message count is wrong")

    def check(self) -> None:
        """Read and verify everything before the summary once.

        Raises:
            DamagedError: The checksum is wrong, or a record is damaged.
        """
        for _ in self._index.data_section():
            pass

    def unchecked(self) -> set[str]:
        """Return the parts of the file that have no checksum."""
        missing = set() if self._index.summary_crc else {"topics and times"}
        if self._index.loose or not all(self._crc_of(offset) for offset in self._index.chunks["offset"].tolist()):
            missing.add("messages")
        return missing

    def _crc_of(self, chunk: int) -> int:
        self._stream.seek(chunk + RECORD.size + 24)
        return int.from_bytes(read_exactly(self._stream, 4, 4), "little")

    def _loose_messages(self, names: _Names) -> Iterator[SerializedMessage]:
        before = 0
        for opcode, content in self._index.data_section():
            if opcode == Opcode.MESSAGE:
                channel, sequence, log_time, publish_time = message_head(content)
                if log_time < before:
                    raise DamagedError("its messages are not in the order of their log time, and it has no index")
                before = log_time
                if channel in names:
                    data = content[MESSAGE.size :]
                    yield SerializedMessage(*names[channel], log_time, publish_time, sequence, data)

    def _merged(self, names: _Names, first: int, last: int) -> Iterator[SerializedMessage]:
        """Merge the messages of all chunks by log time; a chunk is opened only when its first message is due."""
        chunks, chosen, waiting, opened = self._index.chunks, frozenset(names), _Waiting(), 0
        for number in np.argsort(chunks["start"], kind="stable").tolist():
            channels = self._index.chunk_channels[number]
            start, end, *_, size = chunks[number].item()
            if end < first or start > last or not (channels is None or channels & chosen):
                continue
            opened -= yield from self._drain(waiting, start)
            opened += size
            if waiting and opened > self._limits.open_bytes:
                raise DamagedError(
                    f"its chunks overlap: {opened:,} bytes at {start} ns, at most {self._limits.open_bytes:,}"
                )
            messages = self._messages_of(number, names, chosen)
            message = next(messages, None)
            if message is None:
                opened -= size
            else:
                heappush(waiting, (message.log_time, number, message, messages))
        yield from self._drain(waiting, 1 << 64)

    def _drain(self, waiting: _Waiting, stop: int) -> Generator[SerializedMessage, None, int]:
        """Yield messages of open chunks older than `stop`; return the size of the exhausted chunks."""
        freed = 0
        while waiting and waiting[0][0] < stop:
            _, number, message, messages = waiting[0]
            yield message
            following = next(messages, None)
            if following is None:
                heappop(waiting)
                freed += int(self._index.chunks[number]["size"])
            else:
                heapreplace(waiting, (following.log_time, number, following, messages))
        return freed

    def _messages_of(self, number: int, names: _Names, chosen: frozenset[int]) -> Iterator[SerializedMessage]:
        """Yield a chunk's messages in log-time order."""
        start, end, offset, record_length, size = self._index.chunks[number].item()
        self._stream.seek(offset)
        opcode, length = RECORD.unpack(read_exactly(self._stream, RECORD.size, RECORD.size))
        if opcode != Opcode.CHUNK or RECORD.size + length != record_length:
            raise DamagedError("its index refers to a missing chunk")
        content = read_exactly(self._stream, length, self._limits.chunk_bytes + READ_AT_ONCE)
        if chunk_head(content)[:3] != (start, end, size):
            raise DamagedError("a chunk is not what the index says")
        records = decompress(content, self._limits.chunk_bytes)
        _, times, places = index_messages(records, chosen, start, end)
        order = np.argsort(np.frombuffer(times, np.uint64), kind="stable")
        for at in array("Q", np.frombuffer(places, np.uint64)[order].tobytes()):
            head = at - RECORD.size
            _, length, channel, sequence, log_time, publish_time = _MESSAGE_RECORD.unpack_from(records, head)
            data = records[at + MESSAGE.size : at + length]
            yield SerializedMessage(*names[channel], log_time, publish_time, sequence, data)
