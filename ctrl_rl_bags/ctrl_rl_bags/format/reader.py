"""Reads rosbag2 folders, MCAP or the older sqlite3, without ROS; messages are decoded with the bag's own definitions.

Bags are not trusted: memory is bounded (`Limits`), every checksum is verified, and `metadata.yaml` must agree with the
files.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

import zstandard

from ctrl_rl_bags.format.bag_info import BagInfo, TopicInfo, compare, completed, recover_hint
from ctrl_rl_bags.format.checks import BagError, DamagedError, LargeChunkError, open_regular, printable, reason
from ctrl_rl_bags.format.mcap_reader import McapReader
from ctrl_rl_bags.format.mcap_records import DEFAULT_LIMITS, Limits, decompress_some
from ctrl_rl_bags.format.metadata import METADATA_FILE, BagMetadata, SerializedMessage, Topic, read_metadata
from ctrl_rl_bags.format.sqlite_reader import SqliteReader, with_log
from ctrl_rl_bags.format.type_definitions import BagTypes, Definition

_NOT_MENDED = ("git lfs", "not of ROS 2")
"""Errors with these words cannot be fixed by `bag recover`."""
_ROS1_MAGIC, _ZSTD_MAGIC = b"#ROSBAG V", b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True)
class BagMessage:
    """One message of a bag.

    Attributes:
        topic: Full name of the topic.
        type: Name of the message type, e.g. `sensor_msgs/msg/LaserScan`.
        log_time: Reception time [ns since the epoch].
        data: Decoded message, with NumPy arrays for arrays of numbers.
    """

    topic: str
    type: str
    log_time: int
    data: Any


class Bag:
    """An open bag.

    Attributes:
        path: Folder or file of the bag.
        info: Files, times, topics and counts of the bag.
        topics: Topics by name, with their definitions.
        bytes_read: Size of all messages read so far [bytes].
    """

    def __init__(self, path: Path, limits: Limits, stack: ExitStack) -> None:
        self.path = path
        self.bytes_read = 0
        self._limits = limits
        try:
            self._metadata = read_metadata(path) if path.is_dir() else None
        except BagError as error:
            raise BagError(f"{error}{recover_hint(path)}") from None
        self._notes: list[str] = []
        names = self._metadata.relative_file_paths if self._metadata else [path.name]
        folder = path if path.is_dir() else path.parent
        self._files = [self._find(folder, PurePosixPath(name).name) for name in names]
        self._by_message = False
        if self._metadata and self._metadata.compression_mode and self._metadata.compression_mode.lower() != "none":
            self._uncompress(self._metadata, stack)
        self._storage: str = self._metadata.storage_identifier if self._metadata else ""
        if not self._storage and self._files:
            self._storage = _storage_of(self._files[0])
            if self._metadata:
                self._notes.append(f"{METADATA_FILE} names no storage, the files are {self._storage}")
        if self._storage == "sqlite3":
            self._add_logs(stack)
        self.topics: dict[str, Topic] = {}
        self._mixed: dict[str, str] = {}
        self._spans: list[tuple[int, int] | None] = []
        self.info = self._read_info(tuple(names))
        if self._metadata:
            self._notes += compare(self._metadata, self.info, self._mixed)
        self.info = replace(self.info, notes=tuple(self._notes))

    def messages(
        self, topics: Iterable[str] = (), start: int | None = None, stop: int | None = None
    ) -> Iterator[SerializedMessage]:
        """Yield serialised messages, file by file, in log-time order.

        Args:
            topics: Topics to read; all if empty.
            start: First log time [ns], inclusive.
            stop: Last log time [ns], exclusive.

        Raises:
            BagError: The bag has no such topic, or is damaged.
        """
        wanted = set(topics)
        if missing := wanted - set(self.topics):
            known = printable(", ".join(sorted(self.topics)))
            raise BagError(f"{self.path} has no topic {', '.join(sorted(missing))}; it has {known or 'none'}")
        wanted = wanted or set(self.topics)
        if mixed := sorted(wanted & set(self._mixed)):
            both = f"{printable(mixed[0])} has messages of two types, {self._mixed[mixed[0]]}"
            raise BagError(f"{self.path}: {both}{recover_hint(self.path)}")
        for file, span in zip(self._files, self._spans, strict=True):
            if span is None or (start is not None and span[1] < start) or (stop is not None and span[0] >= stop):
                continue
            with self._open(file) as source:
                for message in source.messages(wanted, start, stop):
                    self.bytes_read += len(message.data)
                    yield message._replace(data=self._plain(message.data)) if self._by_message else message

    def decoded(
        self, topics: Iterable[str] = (), start: int | None = None, stop: int | None = None
    ) -> Iterator[BagMessage]:
        """Yield decoded messages; arguments and errors as for `messages`."""
        topics, types = list(topics), None
        for message in self.messages(topics, start, stop):
            types = types or self.types(topics)
            try:
                data = types.decode(message.data, message.type)
            except DamagedError as error:
                topic = printable(message.topic)
                raise BagError(f"{self.path}: a message of {topic} cannot be decoded: {error}") from None
            yield BagMessage(message.topic, message.type, message.log_time, data)

    def check(self) -> None:
        """Verify the checksums not covered by `messages`.

        Raises:
            BagError: The bag is damaged.
        """
        for file in self._files:
            with self._open(file) as source:
                source.check()

    def types(self, topics: Iterable[str] = ()) -> BagTypes:
        """Return a decoder for some topics, or for all if empty.

        Raises:
            BagError: A definition is missing or invalid.
        """
        chosen = [self.topics[name] for name in topics or self.topics]
        kinds = {
            topic.type: Definition(topic.type, topic.definition, topic.encoding, topic.type_hash) for topic in chosen
        }
        try:
            return BagTypes(kinds.values())
        except DamagedError as error:
            raise BagError(f"{self.path}: {error}") from None

    def _find(self, folder: Path, name: str) -> Path:
        """Find a file named in metadata.yaml, even if it has been compressed or uncompressed since."""
        for other in (name, f"{name}.zstd", name.removesuffix(".zstd")):
            if (folder / other).exists():
                if other != name:
                    self._notes.append(f"{METADATA_FILE} says {printable(name)}, the file is {printable(other)}")
                return folder / other
        return folder / name

    def _add_logs(self, stack: ExitStack) -> None:
        """Merge the write-ahead logs of a killed recorder into copies of the files."""
        for number, file in enumerate(self._files):
            log = file.with_name(f"{file.name}-wal")
            if log.exists() and log.stat().st_size:
                folder = Path(stack.enter_context(TemporaryDirectory(prefix="bag-")))
                try:
                    self._files[number] = with_log(file, log, folder, self._limits)
                except (DamagedError, OSError) as error:
                    raise BagError(
                        f"{log} cannot be read: {reason(error)}: move it away to read the bag without it"
                    ) from None
                self._notes.append(f"{printable(log.name)} holds the last messages: they are read, too")

    @contextmanager
    def _open(self, file: Path) -> Iterator[McapReader | SqliteReader]:
        try:
            source = (McapReader if self._storage == "mcap" else SqliteReader)(file, self._limits)
            try:
                yield source
            finally:
                source.close()
        except (DamagedError, OSError) as error:
            hint = "" if any(words in str(error) for words in _NOT_MENDED) else recover_hint(self.path)
            if hint and isinstance(error, LargeChunkError):
                hint += f" --max-chunk-mb {error.megabytes}"
            raise BagError(f"{file} cannot be read: {reason(error)}{hint}") from None

    def _read_info(self, names: tuple[str, ...]) -> BagInfo:
        counts: dict[str, int] = {}
        custom: dict[str, str] = {}
        unchecked: set[str] = set()
        told = self._metadata.topics_with_message_count if self._metadata else []
        offered = {each.topic_metadata.name: each.topic_metadata for each in told}
        for file in self._files:
            with self._open(file) as source:
                for topic, count in source.topics:
                    known = self.topics.setdefault(topic.name, completed(topic, offered))
                    counts[topic.name] = counts.get(topic.name, 0) + count
                    if known.type != topic.type:
                        self._mixed[topic.name] = printable(f"{known.type} and {topic.type}")
                here = sum(count for _, count in source.topics)
                self._spans.append((source.start, source.end) if here else None)
                custom |= source.custom_data
                unchecked |= source.unchecked()
        spans = [span for span in self._spans if span is not None]
        if self._metadata and self._metadata.custom_data is not None:
            if custom and custom != self._metadata.custom_data:
                raise BagError(
                    f"{self.path}: {METADATA_FILE} has other custom data than its files{recover_hint(self.path)}"
                )
            custom = self._metadata.custom_data
        return BagInfo(
            folder=self.path,
            start=min((span[0] for span in spans), default=0),
            end=max((span[1] for span in spans), default=0),
            message_count=sum(counts.values()),
            files=names,
            topics={
                name: TopicInfo(self._mixed.get(name, topic.type), counts[name], topic.type_hash, topic.qos)
                for name, topic in sorted(self.topics.items())
            },
            custom_data=custom,
            unchecked=", ".join(sorted(unchecked)),
        )

    def _uncompress(self, metadata: BagMetadata, stack: ExitStack) -> None:
        """Uncompress a bag that rosbag2 compressed by file or by message."""
        kind, mode = str(metadata.compression_format), str(metadata.compression_mode).lower()
        if kind != "zstd" or mode not in ("file", "message"):
            raise BagError(
                f"{self.path}: its compression {printable(kind)!r} by {printable(mode)!r} is unknown: use zstd by file "
                f"or message{recover_hint(self.path)}"
            )
        self._by_message = mode == "message"
        if self._by_message:
            return
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="bag-")))
        try:
            self._files = [
                _uncompressed(file, folder / file.name.removesuffix(".zstd")) if _is_compressed(file) else file
                for file in self._files
            ]
        except (DamagedError, OSError, zstandard.ZstdError) as error:
            raise BagError(f"{self.path} cannot be uncompressed: {reason(error)}") from None

    def _plain(self, data: bytes) -> bytes:
        plain = decompress_some("zstd", data, self._limits.chunk_bytes)
        if len(plain) > self._limits.chunk_bytes:
            raise DamagedError(f"a message of more than {self._limits.chunk_bytes:,} bytes")
        return plain


@contextmanager
def open_bag(bag: Path | str | Bag, limits: Limits = DEFAULT_LIMITS) -> Iterator[Bag]:
    """Open a bag for repeated reading.

    Args:
        bag: Folder of the bag, one .mcap or .db3 file, or an open bag, which stays open.
        limits: Memory limits.

    Raises:
        BagError: The bag does not exist, is incomplete, or is damaged.
    """
    if isinstance(bag, Bag):
        yield bag
        return
    path = Path(bag)
    if not path.exists():
        raise BagError(f"{path}: there is no such bag")
    if path.is_dir() and not (path / METADATA_FILE).exists():
        if recover_hint(path):
            raise BagError(f"{path} was cut off, it has no {METADATA_FILE}{recover_hint(path)}")
        raise BagError(f"{path} is no bag: it has no {METADATA_FILE}")
    with ExitStack() as stack:
        yield Bag(path, limits, stack)


def read_messages(
    bag: Path | str | Bag, topics: Iterable[str] = (), start: int | None = None, stop: int | None = None
) -> Iterator[BagMessage]:
    """Yield decoded messages of a bag; arguments and errors as for `Bag.messages`."""
    with open_bag(bag) as opened:
        yield from opened.decoded(topics, start, stop)


def read_raw(
    bag: Path | str | Bag,
    topics: Iterable[str] = (),
    start: int | None = None,
    stop: int | None = None,
    limits: Limits = DEFAULT_LIMITS,
) -> Iterator[SerializedMessage]:
    """Like `read_messages`, but for serialised messages, which is five times as fast."""
    with open_bag(bag, limits) as opened:
        yield from opened.messages(topics, start, stop)


def bag_info(bag: Path | str | Bag, limits: Limits = DEFAULT_LIMITS) -> BagInfo:
    """Return the files, times, topics and counts of a bag.

    Raises:
        BagError: The bag does not exist, is incomplete, or is damaged.
    """
    with open_bag(bag, limits) as opened:
        return opened.info


def _storage_of(path: Path) -> str:
    """Identify the storage format of a file by its first bytes."""
    try:
        with open_regular(path) as (stream, _):
            begin = stream.read(len(_ROS1_MAGIC))
    except (OSError, DamagedError) as error:
        raise BagError(f"{path} cannot be read: {reason(error)}") from None
    if begin == _ROS1_MAGIC:
        new = path.with_suffix("")
        raise BagError(f"{path} is a ROS 1 bag: convert it first with rosbags-convert --src {path} --dst {new}")
    return "sqlite3" if begin.startswith(b"SQLite") else "mcap"


def _is_compressed(file: Path) -> bool:
    with open_regular(file) as (stream, _):
        return stream.read(len(_ZSTD_MAGIC)) == _ZSTD_MAGIC


def _uncompressed(file: Path, output: Path) -> Path:
    """Uncompress a file, using at most half of the free disk space."""
    left = shutil.disk_usage(output.parent).free // 2
    with open_regular(file) as (stream, _), output.open("xb") as out:
        for piece in zstandard.ZstdDecompressor().read_to_iter(stream):
            left -= len(piece)
            if left < 0:
                raise DamagedError("it would take more than half of the disk's free space")
            out.write(piece)
    return output
