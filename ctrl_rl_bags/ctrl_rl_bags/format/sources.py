"""The files of a bag behind one face: MCAP, and the older sqlite3."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import apsw
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from ctrl_rl_bags.format.checks import DamagedError, open_regular, reason
from ctrl_rl_bags.format.mcap_reader import McapReader
from ctrl_rl_bags.format.mcap_records import Limits
from ctrl_rl_bags.format.metadata import Topic
from ctrl_rl_bags.format.topics import mcap_topic

_SQLITE_MAGIC = b"SQLite format 3\0"


class SerializedMessage(NamedTuple):
    """One message with all that the bag knows: times [ns since the epoch], the publisher's count, CDR bytes."""

    topic: str
    type: str
    log_time: int
    publish_time: int
    sequence: int
    data: bytes


class Source(Protocol):
    """One open file of a bag.

    Attributes:
        topics: Its topics, with the number of their messages; a topic with messages of two types is there twice.
        start: First log time [ns]; 0 without messages.
        end: Last log time [ns].
        custom_data: Texts that it keeps.
    """

    topics: list[tuple[Topic, int]]
    start: int
    end: int
    custom_data: dict[str, str]

    def messages(self, topics: Collection[str], start: int | None, stop: int | None) -> Iterator[SerializedMessage]:
        """Yield the messages of some topics, log times from `start` to before `stop`, in their order."""
        ...

    def check(self) -> None:
        """Check all that has a checksum and that `messages` does not check."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


def open_source(path: Path, storage: str, limits: Limits) -> Source:
    """Open one file of a bag.

    Args:
        path: Path of the file.
        storage: `mcap` or `sqlite3`.
        limits: Memory that the file may take at most.

    Raises:
        DamagedError: The file is of another kind, or damaged.
        OSError: It cannot be read.
    """
    return McapSource(path, limits) if storage == "mcap" else Sqlite3Source(path, limits)


class McapSource:
    """An MCAP file."""

    def __init__(self, path: Path, limits: Limits) -> None:
        self._reader = McapReader(path, limits)
        reader = self._reader.index
        try:
            self.start, self.end, self.custom_data = reader.start, reader.end, reader.custom_data
            self._topics = {
                number: mcap_topic(channel, reader.schemas.get(channel.schema_id))
                for number, channel in reader.channels.items()
            }
        except BaseException:
            self._reader.close()
            raise
        counts: dict[tuple[str, str], tuple[Topic, int]] = {}
        for number, topic in self._topics.items():
            known, count = counts.get((topic.name, topic.type), (topic, 0))
            counts[topic.name, topic.type] = known, count + reader.counts.get(number, 0)
        self.topics = list(counts.values())

    def messages(self, topics: Collection[str], start: int | None, stop: int | None) -> Iterator[SerializedMessage]:
        """Yield the messages of some topics, as `Source.messages`."""
        chosen = {number: (topic.name, topic.type) for number, topic in self._topics.items() if topic.name in topics}
        for number in chosen:
            encoding = self._reader.index.channels[number].message_encoding
            if encoding != "cdr":
                raise DamagedError(f"{chosen[number][0]} is encoded as {encoding[:40]!r}, not as cdr")
        for channel, sequence, log_time, publish_time, data in self._reader.messages(chosen, start, stop):
            yield SerializedMessage(*chosen[channel], log_time, publish_time, sequence, data)

    def check(self) -> None:
        """Check the checksum of the data."""
        self._reader.check_data()

    def checksums(self) -> tuple[bool, bool]:
        """Return whether the summary has a checksum, and whether all messages have one."""
        return self._reader.checksums()

    def close(self) -> None:
        """Close the file."""
        self._reader.close()


class Sqlite3Source:
    """An sqlite3 file; it knows neither publication times nor counts: these are the log time and 0."""

    def __init__(self, path: Path, limits: Limits) -> None:
        self._limits = limits
        self.custom_data: dict[str, str] = {}
        with open_regular(path) as (stream, _):
            if stream.read(len(_SQLITE_MAGIC)) != _SQLITE_MAGIC:
                raise DamagedError("it is no sqlite3 file")
        # Of the process: a row may be computed, and so be of any size.
        apsw.hard_heap_limit(2 * limits.open_bytes)
        self._reader = Sqlite3Reader(path)
        try:
            self._reader.open()
            connections = list(self._reader.connections)
            self.topics = [(_sqlite_topic(connection), int(connection.msgcount)) for connection in connections]
            metadata = self._reader.metadata
            empty = not metadata.message_count
            self.start, self.end = (0, 0) if empty else (int(metadata.start_time), int(metadata.end_time) - 1)
        except Exception as error:
            raise DamagedError(reason(error)) from None

    def messages(self, topics: Collection[str], start: int | None, stop: int | None) -> Iterator[SerializedMessage]:
        """Yield the messages of some topics, as `Source.messages`."""
        chosen = [connection for connection in self._reader.connections if connection.topic in topics]
        if not chosen:
            return
        try:
            for connection, time, data in self._reader.messages(chosen, start, stop):
                if not (isinstance(time, int) and isinstance(data, bytes) and 0 <= time < 1 << 63):
                    raise DamagedError("a message is no message")
                if len(data) > self._limits.chunk_bytes:
                    raise DamagedError(
                        f"a message of {len(data):,} bytes, where at most {self._limits.chunk_bytes:,} are read"
                    )
                yield SerializedMessage(connection.topic, connection.msgtype, time, time, 0, data)
        except DamagedError:
            raise
        except Exception as error:
            raise DamagedError(reason(error)) from None

    def check(self) -> None:
        """Do nothing: the format has no checksum."""

    def close(self) -> None:
        """Close the file."""
        with suppress(Exception):
            self._reader.close()


def _sqlite_topic(connection: Any) -> Topic:
    encoding = {1: "ros2msg", 2: "ros2idl"}.get(connection.msgdef.format.value, "ros2msg")
    qos = tuple(dump_qos_v9(connection.ext.offered_qos_profiles))
    return Topic(
        str(connection.topic), str(connection.msgtype), connection.msgdef.data, connection.digest or "", qos, encoding
    )
