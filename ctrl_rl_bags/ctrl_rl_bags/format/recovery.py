"""Recovers bags truncated by a SIGKILL, a power cut or a full disk.

An MCAP file is a sequence of records, each preceded by its length. All complete records are copied to a new bag, whose
metadata is rebuilt. The original bag is never changed. Records that cannot be read, or that need more memory than
the limits allow, are dropped and counted.
"""

from __future__ import annotations

import re
import shutil
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from tqdm import tqdm

from ctrl_rl_bags.format.bag_info import is_bag_file
from ctrl_rl_bags.format.checks import BagError, DamagedError, open_regular, printable, reason
from ctrl_rl_bags.format.copy import bag_topics
from ctrl_rl_bags.format.mcap_records import (
    DEFAULT_LIMITS,
    MAGIC,
    MESSAGE,
    OPCODES,
    RECORD,
    Limits,
    chunk_head,
    decompress_some,
    parse,
    records_in,
)
from ctrl_rl_bags.format.metadata import CUSTOM_DATA_RECORD, METADATA_FILE, Topic, mcap_topic, name_of_other_type
from ctrl_rl_bags.format.reader import open_bag
from ctrl_rl_bags.format.writer import BagWriter

_READ = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.METADATA)


@dataclass
class Recovery:
    """Result of a recovery.

    Attributes:
        source: Path of the original bag.
        folder: Folder of the recovered bag; None if the bag is complete and nothing was written.
        messages: Number of messages by topic.
        start: First log time [ns]; None without messages.
        end: Last log time [ns].
        dropped_bytes: Total number of unreadable bytes.
        unfinished: Names of truncated or damaged files.
        too_large: Number of chunks and records dropped because they exceed the memory limits.
        foreign: Number of messages omitted because they are not ROS 2 (JSON, protobuf, ROS 1).
    """

    source: Path
    folder: Path | None = None
    messages: Counter[str] = field(default_factory=Counter)
    start: int | None = None
    end: int | None = None
    dropped_bytes: int = 0
    unfinished: list[str] = field(default_factory=list)
    too_large: int = 0
    foreign: int = 0


def recover(
    bag: Path | str, output: Path | str | None = None, *, progress: bool = False, limits: Limits = DEFAULT_LIMITS
) -> Recovery:
    """Copy the readable part of an incomplete bag to a new bag.

    Args:
        bag: Folder of the bag, or one .mcap file.
        output: Folder of the new bag, which must not exist; `<bag>_recovered` if None.
        progress: Whether to show a progress bar on a terminal.
        limits: Memory limits.

    Raises:
        BagError: There is nothing readable, or the output exists or cannot be written.
    """
    source = Path(bag).absolute()
    if not source.exists():
        raise BagError(f"{bag}: there is no such bag")
    files = sorted(filter(is_bag_file, source.iterdir()), key=_file_order) if source.is_dir() else [source]
    if not files:
        raise BagError(f"{bag} holds no .mcap or .db3 file: there is nothing to recover")
    if source.is_file() and not is_bag_file(source):
        raise BagError(f"{bag} is no .mcap or .db3 file: there is nothing to recover")
    whole = _whole(source, files, limits)
    if whole is not None:
        return whole
    folder = (
        Path(output)
        if output is not None
        else source.with_name(f"{source.stem if source.is_file() else source.name}_recovered")
    )
    if folder.exists():
        raise BagError(f"{folder} exists: a bag is never overwritten; name another folder")
    out = Recovery(source, folder)
    copy = _Copy(folder, max(file.stat().st_size for file in files) if len(files) > 1 else 0, out, limits)
    try:
        for file in tqdm(files, desc="recover", unit="file", disable=None if progress else True):
            (copy.add_database if file.suffix == ".db3" else copy.add_file)(file)
        copy.finish()
    except BaseException:
        copy.discard()
        raise
    return out


class _Copy:
    """Copies the readable part of each file to a new bag."""

    def __init__(self, folder: Path, max_file_bytes: int, found: Recovery, limits: Limits) -> None:
        self._folder = folder
        self._max_file_bytes = max_file_bytes
        self._found = found
        self._limits = limits
        self._writer: BagWriter | None = None
        self._topics: dict[str, Topic] = {}
        self._custom_data: dict[str, str] = {}
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, str] = {}
        self._kept_bytes = 0
        self._finished = False
        self._foreign: Counter[str] = Counter()
        self._strangers: set[int] = set()

    def add_file(self, path: Path) -> None:
        self._schemas, self._channels, self._strangers, self._kept_bytes = {}, {}, set(), 0
        dropped_before, self._finished = self._found.dropped_bytes, False
        try:
            with open_regular(path) as (stream, size):
                for opcode, content in self._records(stream, size):
                    try:
                        self._add_record(opcode, content)
                    except DamagedError:
                        self._found.dropped_bytes += len(content)
        except (DamagedError, OSError) as error:
            raise BagError(f"{path} cannot be read: {reason(error)}") from None
        if not self._finished or self._found.dropped_bytes > dropped_before:
            self._found.unfinished.append(path.name)

    def add_database(self, path: Path) -> None:
        """Copy the messages of an sqlite3 file, up to the first unreadable one."""
        try:
            with open_bag(path, self._limits) as bag:
                for topic in bag_topics(bag):
                    self._topics.setdefault(topic.name, topic)
                try:
                    for message in bag.messages():
                        self._write(message.topic, message.data, message.log_time, message.publish_time, 0)
                except BagError:
                    self._found.unfinished.append(path.name)
        except BagError as error:
            raise BagError(f"{path}: {error}") from None

    def finish(self) -> None:
        if self._writer is None and self._foreign:
            kinds = printable(", ".join(sorted(self._foreign)))
            raise BagError(f"{self._found.source} holds no ROS 2 messages: they are encoded as {kinds}")
        if self._writer is None:
            large = f" ({self._found.too_large} chunks are larger than --max-chunk-mb)" if self._found.too_large else ""
            raise BagError(f"{self._found.source} holds no readable message{large}: there is nothing to recover")
        for name, topic in self._topics.items():
            if name not in self._writer.message_counts:
                self._writer.add_topic(topic)
        for key, value in self._custom_data.items():
            self._writer.set_custom_data(key, value)
        self._writer.close()

    def discard(self) -> None:
        if self._writer is not None:
            with suppress(BagError):
                self._writer.close()
            shutil.rmtree(self._folder, ignore_errors=True)

    def _add_record(self, opcode: int, content: bytes) -> None:
        if opcode == Opcode.MESSAGE:
            self._add_message(content)
            return
        if self._kept_bytes + len(content) > self._limits.topics_bytes:
            raise DamagedError("too many topics")
        record = parse(opcode, content)
        self._kept_bytes += len(content)
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._add_channel(record)
        elif isinstance(record, Metadata) and record.name == CUSTOM_DATA_RECORD:
            self._custom_data.update(record.metadata)

    def _add_channel(self, channel: Channel) -> None:
        if channel.message_encoding != "cdr":
            self._foreign[channel.message_encoding[:40] or "nothing"] += 1
            self._strangers.add(channel.id)
            return
        schema = self._schemas.get(channel.schema_id) or Schema(0, b"", "", "unknown/msg/Unknown")
        topic = mcap_topic(channel, schema)
        if self._topics.get(topic.name, topic).type != topic.type:
            topic = replace(topic, name=name_of_other_type(topic.name, topic.type))
        self._channels[channel.id] = topic.name
        self._topics.setdefault(topic.name, topic)

    def _add_message(self, content: bytes) -> None:
        if len(content) < MESSAGE.size:
            raise DamagedError("message of an unknown channel")
        channel, sequence, log_time, publish_time = MESSAGE.unpack_from(content)
        if channel in self._strangers:
            self._found.foreign += 1
            return
        name = self._channels.get(channel)
        if name is None:
            raise DamagedError("message of an unknown channel")
        self._write(name, content[MESSAGE.size :], log_time, publish_time, sequence)

    def _write(self, name: str, data: bytes, log_time: int, publish_time: int, sequence: int) -> None:
        if self._writer is None:
            self._writer = BagWriter(self._folder, max_file_bytes=self._max_file_bytes)
        if name not in self._writer.message_counts:
            self._writer.add_topic(self._topics[name])
        self._writer.write(name, data, log_time, publish_time, sequence)
        found = self._found
        found.messages[name] += 1
        found.start = log_time if found.start is None else min(found.start, log_time)
        found.end = log_time if found.end is None else max(found.end, log_time)

    def _records(self, stream: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
        """Yield opcode and content of every readable record before the summary, including records in chunks."""
        if stream.read(len(MAGIC)) != MAGIC:
            self._found.dropped_bytes += size
            return
        while True:
            head = stream.read(RECORD.size)
            if len(head) < RECORD.size:
                self._found.dropped_bytes += len(head)
                return
            opcode, length = RECORD.unpack(head)
            if opcode == Opcode.DATA_END:
                self._finished = _ends_well(stream, size)
                return
            if opcode not in OPCODES:  # e.g. zeros in a hole left by a power cut
                self._found.dropped_bytes += size - stream.tell() + len(head)
                return
            left = size - stream.tell()
            if length > left and opcode not in (Opcode.CHUNK, *_READ):
                self._found.dropped_bytes += left + len(head)
                return
            if opcode not in (Opcode.CHUNK, *_READ):
                stream.seek(length, 1)
            elif min(length, left) > self._limits.chunk_bytes:
                self._drop(min(length, left), too_large=True)
                stream.seek(min(length, left), 1)
            else:
                content = stream.read(min(length, left))
                yield from self._open_record(opcode, content, len(content) == length)

    def _open_record(self, opcode: int, content: bytes, whole: bool) -> Iterator[tuple[int, bytes]]:
        if opcode == Opcode.CHUNK:
            inside, sound = self._decompress(content, whole)
            with suppress(DamagedError):
                for inner, at, length in records_in(inside):
                    yield inner, inside[at : at + length]
            whole = whole and sound
        elif whole:
            yield opcode, content
        if not whole:
            self._drop(len(content))

    def _decompress(self, chunk: bytes, whole: bool) -> tuple[bytes, bool]:
        """Decompress as many of a chunk's records as possible, and return whether they are complete."""
        try:
            head = chunk_head(chunk, whole)
            if head.size > self._limits.chunk_bytes:
                self._found.too_large += 1
                return b"", False
            records = decompress_some(head.compression, chunk[head.data_at :], head.size)
        except DamagedError:
            return b"", False
        if len(records) < head.size:
            return records, False
        if len(records) > head.size or (head.crc and zlib.crc32(records) != head.crc):
            return b"", False
        return records, True

    def _drop(self, content: int, too_large: bool = False) -> None:
        self._found.dropped_bytes += RECORD.size + content
        self._found.too_large += too_large


def _whole(source: Path, files: list[Path], limits: Limits) -> Recovery | None:
    """Return a bag's content if all of it is readable, else None."""
    if source.is_dir() and not (source / METADATA_FILE).exists():
        return None
    try:
        with open_bag(source, limits) as bag:
            if {Path(name).name for name in bag.info.files} != {file.name for file in files}:
                return None
            bag.check()
            for _ in bag.messages():
                pass
            info = bag.info
    except BagError:
        return None
    empty = info.message_count == 0
    return Recovery(
        source,
        messages=Counter({name: topic.message_count for name, topic in info.topics.items()}),
        start=None if empty else info.start,
        end=None if empty else info.end,
    )


def _ends_well(stream: BinaryIO, size: int) -> bool:
    stream.seek(max(0, size - len(MAGIC)))
    return stream.read() == MAGIC


def _file_order(path: Path) -> tuple[int, str]:
    """Sort key that puts `name_10.mcap` after `name_9.mcap`."""
    number = re.search(r"(\d+)$", path.stem)
    return (int(number[1]) if number else -1, path.name)
