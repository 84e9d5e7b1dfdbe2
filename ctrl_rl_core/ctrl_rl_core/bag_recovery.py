"""Mends bags that were cut off by a SIGKILL, a power cut or a full disk.

An MCAP file is a row of records, each with its length in front. All whole records are read, messages are written to a
new bag, and the bag's metadata is rebuilt from them. The cut-off bag itself is only read.
"""

from __future__ import annotations

import os
import re
import shutil
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos
from tqdm import tqdm

from ctrl_rl_core.bag_metadata import CUSTOM_DATA_RECORD, METADATA_FILE, BagError, Qos, Topic
from ctrl_rl_core.bag_reader import bag_info, read_raw
from ctrl_rl_core.bag_writer import BagWriter
from ctrl_rl_core.mcap_file import MAGIC

_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQI")
_MESSAGE = struct.Struct("<HIQQ")
_OPCODES = {int(opcode) for opcode in Opcode}
_BROKEN = (McapError, struct.error, UnicodeDecodeError, ValueError, zstandard.ZstdError, RuntimeError)


@dataclass
class Recovery:
    """What was found in a bag.

    Attributes:
        source: the bag that was read.
        folder: the mended bag, None if the bag was whole and nothing was written.
        messages: number of messages by topic.
        start: first log time [ns], None without messages.
        end: last log time [ns].
        dropped_bytes: what could not be read, of all files together.
        unfinished: names of the files that were cut off or damaged.
    """

    source: Path
    folder: Path | None = None
    messages: dict[str, int] = field(default_factory=dict)
    start: int | None = None
    end: int | None = None
    dropped_bytes: int = 0
    unfinished: list[str] = field(default_factory=list)


def recover(bag: Path | str, output: Path | str | None = None, *, progress: bool = False) -> Recovery:
    """Write what can be read of a cut-off bag as a new, whole bag.

    Args:
        bag: the folder of the bag.
        output: the new folder, `<bag>_recovered` if None; it must not exist.
        progress: show a bar on a terminal.

    Raises:
        BagError: no MCAP bag, nothing readable in it, or the output exists or cannot be written.
    """
    source = Path(bag).absolute()
    if not source.is_dir():
        raise BagError(f"{bag}: there is no such bag folder")
    files = sorted(source.glob("*.mcap"), key=_file_order)
    if not files:
        raise BagError(f"{bag} holds no .mcap file: there is nothing to recover")
    whole = _whole(source, files)
    if whole is not None:
        return whole
    folder = Path(output) if output is not None else source.with_name(source.name + "_recovered")
    if folder.exists():
        raise BagError(f"{folder} exists: a bag is never overwritten; name another folder")
    out = Recovery(source, folder)
    copy = _Copy(folder, max(file.stat().st_size for file in files) if len(files) > 1 else 0, out)
    try:
        for file in tqdm(files, desc="recover", unit="file", disable=None if progress else True):
            copy.add_file(file)
        copy.finish()
    except BaseException:
        copy.discard()
        raise
    return out


class _Copy:
    """Writes the readable part of one file after the other to a new bag."""

    def __init__(self, folder: Path, max_file_bytes: int, found: Recovery) -> None:
        self._folder = folder
        self._max_file_bytes = max_file_bytes
        self._found = found
        self._writer: BagWriter | None = None
        self._topics: dict[str, Topic] = {}
        self._custom_data: dict[str, str] = {}
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, str] = {}

    def add_file(self, path: Path) -> None:
        self._schemas, self._channels = {}, {}
        scan = _Scan(path)
        for opcode, content in scan.records():
            try:
                self._add_record(opcode, content)
            except _BROKEN:
                scan.dropped_bytes += len(content)
        if scan.dropped_bytes or not scan.finished:
            self._found.unfinished.append(path.name)
            self._found.dropped_bytes += scan.dropped_bytes

    def finish(self) -> None:
        if self._writer is None:
            raise BagError(f"{self._found.source} holds no readable message: there is nothing to recover")
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
        stream = ReadDataStream(BytesIO(content))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            self._add_channel(Channel.read(stream))
        elif opcode == Opcode.MESSAGE:
            self._add_message(content)
        elif opcode == Opcode.METADATA:
            record = Metadata.read(stream)
            if record.name == CUSTOM_DATA_RECORD:
                self._custom_data.update(record.metadata)

    def _add_channel(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id) or Schema(0, b"", "", "unknown/msg/Unknown")
        self._channels[channel.id] = channel.topic
        self._topics.setdefault(
            channel.topic,
            Topic(
                name=channel.topic,
                type=schema.name,
                definition=schema.data.decode(),
                type_hash=channel.metadata.get("topic_type_hash", ""),
                qos=_qos(channel.metadata.get("offered_qos_profiles", "")),
                encoding=schema.encoding,
            ),
        )

    def _add_message(self, content: bytes) -> None:
        channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(content)
        name = self._channels.get(channel)
        if name is None:
            raise ValueError("message of an unknown channel")
        if self._writer is None:
            self._writer = BagWriter(self._folder, max_file_bytes=self._max_file_bytes)
        if name not in self._writer.message_counts:
            self._writer.add_topic(self._topics[name])
        self._writer.write(name, content[_MESSAGE.size :], log_time, publish_time, sequence)
        found = self._found
        found.messages[name] = found.messages.get(name, 0) + 1
        found.start = log_time if found.start is None else min(found.start, log_time)
        found.end = log_time if found.end is None else max(found.end, log_time)


class _Scan:
    """Reads one file record by record, as far as it goes."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.finished = False
        self.dropped_bytes = 0

    def records(self) -> Iterator[tuple[int, bytes]]:
        """Yield opcode and content of every readable record before the summary, those in chunks too."""
        with self.path.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            if stream.read(len(MAGIC)) != MAGIC:
                self.dropped_bytes = size
                return
            while True:
                head = stream.read(_RECORD.size)
                if len(head) < _RECORD.size:
                    self.dropped_bytes += len(head)
                    return
                opcode, length = _RECORD.unpack(head)
                if opcode == Opcode.DATA_END:
                    self.finished = _ends_well(stream, size)
                    return
                if opcode not in _OPCODES:  # zeros, say, where a power cut left a hole
                    self.dropped_bytes += size - stream.tell() + len(head)
                    return
                content = stream.read(min(length, size))
                yield from self._open_record(opcode, content, len(content) == length)

    def _open_record(self, opcode: int, content: bytes, whole: bool) -> Iterator[tuple[int, bytes]]:
        if opcode == Opcode.CHUNK:
            inside, sound = _decompress(content)
            yield from _split_records(inside)
            whole = whole and sound
        elif whole:
            yield opcode, content
        if not whole:
            self.dropped_bytes += _RECORD.size + len(content)


def _whole(source: Path, files: list[Path]) -> Recovery | None:
    """Return what a bag holds if all of it can be read, None if it has to be mended."""
    if not (source / METADATA_FILE).exists():
        return None
    try:
        info = bag_info(source)
        by_index = sum(1 for _ in read_raw(source))
    except BagError:
        return None
    scans = [_Scan(file) for file in files]
    count = sum(opcode == Opcode.MESSAGE for scan in scans for opcode, _ in scan.records())
    if any(scan.dropped_bytes or not scan.finished for scan in scans) or not count == by_index == info.message_count:
        return None
    empty = info.message_count == 0
    return Recovery(
        source,
        messages={name: topic.message_count for name, topic in info.topics.items()},
        start=None if empty else info.start,
        end=None if empty else info.end,
    )


def _decompress(chunk: bytes) -> tuple[bytes, bool]:
    """Return a chunk's records, and whether that is all of them; of a torn chunk, what its compression lets through."""
    try:
        _start, _end, size, crc = _CHUNK.unpack_from(chunk)
        name_size = int.from_bytes(chunk[_CHUNK.size : _CHUNK.size + 4], "little")
        name = chunk[_CHUNK.size + 4 : _CHUNK.size + 4 + name_size]
        data = chunk[_CHUNK.size + 4 + name_size + 8 :]
        if name == b"zstd":
            records = zstandard.ZstdDecompressor().decompressobj().decompress(data)
        elif name == b"lz4":
            records = lz4.frame.LZ4FrameDecompressor().decompress(data)
        else:
            records = data
    except _BROKEN:
        return b"", False
    if len(records) < size:
        return records, False
    if crc and zlib.crc32(records) != crc:
        return b"", False
    return records, True


def _split_records(data: bytes) -> Iterator[tuple[int, bytes]]:
    position = 0
    while position + _RECORD.size <= len(data):
        opcode, length = _RECORD.unpack_from(data, position)
        position += _RECORD.size + length
        if position <= len(data):
            yield opcode, data[position - length : position]


def _ends_well(stream: BinaryIO, size: int) -> bool:
    stream.seek(max(0, size - len(MAGIC)))
    return stream.read() == MAGIC


def _qos(text: str) -> tuple[Qos, ...]:
    with suppress(ReaderError, KeyError, TypeError, ValueError, AttributeError):
        return tuple(dump_qos_v9(parse_qos(text)))
    return ()


def _file_order(path: Path) -> tuple[int, str]:
    """Order `name_10.mcap` behind `name_9.mcap`."""
    number = re.search(r"(\d+)$", path.stem)
    return (int(number[1]) if number else -1, path.name)
