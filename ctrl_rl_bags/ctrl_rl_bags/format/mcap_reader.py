"""Reads one MCAP file in the order of its log time, within bounds, and checks each checksum of what it reads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from heapq import heappush
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode

from ctrl_rl_bags.format.checks import DamagedError, open_regular
from ctrl_rl_bags.format.mcap_chunks import McapMessage, OpenChunk, drain, index_messages, message_head
from ctrl_rl_bags.format.mcap_index import McapIndex
from ctrl_rl_bags.format.mcap_records import (
    DEFAULT_LIMITS,
    MESSAGE,
    READ_AT_ONCE,
    RECORD,
    Limits,
    chunk_head,
    decompress,
    read_exactly,
)


class McapReader:
    """One MCAP file, open until `close`.

    Attributes:
        path: Path of the file.
        index: Topics, chunks and counts of the file.

    Raises:
        DamagedError: The file is no whole MCAP file, a checksum is wrong, or it asks for more than the limits allow.
        OSError: The file cannot be read.
    """

    def __init__(self, path: Path, limits: Limits = DEFAULT_LIMITS) -> None:
        self.path = path
        self._limits = limits
        self._stack = ExitStack()
        try:
            self._stream, size = self._stack.enter_context(open_regular(path))
            self.index = McapIndex(self._stream, size, limits)
        except BaseException:
            self.close()
            raise

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
            DamagedError: A chunk or a message is damaged, or some are missing.
        """
        chosen = frozenset(self.index.channels if channels is None else channels)
        first, last = start or 0, (1 << 64) - 1 if stop is None else stop - 1
        left = Counter({channel: self.index.counts.get(channel, 0) for channel in chosen})
        for message in self._loose_messages(chosen) if self.index.loose else self._merged(chosen, first, last):
            if first <= message.log_time <= last:
                left[message.channel] -= 1
                yield message
        if start is None and stop is None and any(left.values()):
            raise DamagedError("it does not hold as many messages as it says")

    def check_data(self) -> None:
        """Read the file once, and check all of it that precedes the summary.

        Raises:
            DamagedError: The checksum is wrong, or a record is damaged.
        """
        for _ in self.index.data_section():
            pass

    def checksums(self) -> tuple[bool, bool]:
        """Return whether the summary has a checksum, and whether all messages have one."""
        return self.index.summary_crc != 0, not self.index.loose and all(
            self._crc_of(offset) for offset in self.index.chunks.offset
        )

    def _crc_of(self, chunk: int) -> int:
        self._stream.seek(chunk + RECORD.size + 24)
        return int.from_bytes(read_exactly(self._stream, 4, 4), "little")

    def _loose_messages(self, chosen: frozenset[int]) -> Iterator[McapMessage]:
        before = 0
        for opcode, content in self.index.data_section():
            if opcode == Opcode.MESSAGE:
                head = message_head(content)
                if head[2] < before:
                    raise DamagedError("its messages are not in the order of their log time, and it has no index")
                before = head[2]
                if head[0] in chosen:
                    yield McapMessage(*head, content[MESSAGE.size :])

    def _merged(self, chosen: frozenset[int], first: int, last: int) -> Iterator[McapMessage]:
        """Yield messages of all chunks in the order of their log time; no chunk is opened before its time."""
        chunks, waiting, opened = self.index.chunks, list[tuple[int, int, OpenChunk]](), 0
        for number in np.argsort(np.frombuffer(chunks.start, np.uint64), kind="stable").tolist():
            channels, start = chunks.channels[number], chunks.start[number]
            if chunks.end[number] < first or start > last or not (channels is None or channels & chosen):
                continue
            opened -= yield from drain(waiting, start)
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
        yield from drain(waiting, 1 << 64)

    def _open_chunk(self, number: int, chosen: frozenset[int]) -> OpenChunk:
        chunks = self.index.chunks
        self._stream.seek(chunks.offset[number])
        opcode, length = RECORD.unpack(read_exactly(self._stream, RECORD.size, RECORD.size))
        if opcode != Opcode.CHUNK or RECORD.size + length != chunks.length[number]:
            raise DamagedError("its index has a chunk where there is none")
        content = read_exactly(self._stream, length, self._limits.chunk_bytes + READ_AT_ONCE)
        head = chunk_head(content)
        if (head.start, head.end, head.size) != (chunks.start[number], chunks.end[number], chunks.size[number]):
            raise DamagedError("a chunk is not what the index says")
        records = decompress(content, self._limits.chunk_bytes)
        _, times, places = index_messages(records, chosen, head.start, head.end)
        return OpenChunk(records, times, places, chunks.size[number])
