"""Reads sqlite3 files, the format before MCAP, with rosbags in bounded memory."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import apsw
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from ctrl_rl_bags.format.checks import DamagedError, open_regular, reason
from ctrl_rl_bags.format.mcap_records import Limits
from ctrl_rl_bags.format.metadata import SerializedMessage, Topic

_SQLITE_MAGIC = b"SQLite format 3\0"


class SqliteReader:
    """An sqlite3 file, open until `close`; attributes as in `McapReader`.

    Raises:
        DamagedError: The file is of another kind, or damaged.
        OSError: The file cannot be read.
    """

    def __init__(self, path: Path, limits: Limits) -> None:
        self._limits = limits
        self.custom_data: dict[str, str] = {}
        with open_regular(path) as (stream, _):
            if stream.read(len(_SQLITE_MAGIC)) != _SQLITE_MAGIC:
                raise DamagedError("it is not an sqlite3 file")
        # A process-wide limit: a row may be computed, and thus have any size.
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
        """Yield the messages of some topics in log-time order, from `start` to before `stop` [ns].

        Raises:
            DamagedError: A message is damaged or too large.
        """
        chosen = [connection for connection in self._reader.connections if connection.topic in topics]
        if not chosen:
            return
        try:
            for connection, time, data in self._reader.messages(chosen, start, stop):
                if not (isinstance(time, int) and isinstance(data, bytes) and 0 <= time < 1 << 63):
                    raise DamagedError("a message is invalid")
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
        """Do nothing; the format has no checksums."""

    def unchecked(self) -> set[str]:
        """Return the parts of the file that have no checksum."""
        return {"everything: sqlite3 has no checksums"}

    def close(self) -> None:
        """Close the file."""
        with suppress(Exception):
            self._reader.close()


def with_log(path: Path, log: Path, folder: Path, limits: Limits) -> Path:
    """Copy an sqlite3 file into `folder` and merge its write-ahead log into the copy.

    Raises:
        DamagedError: The log is damaged, or the copies need more than half of the disk's free space.
        OSError: The files cannot be copied.
    """
    copy = folder / path.name
    left = shutil.disk_usage(folder).free // 2
    for source, name in ((path, copy), (log, copy.with_name(f"{copy.name}-wal"))):
        with open_regular(source, left) as (stream, size), name.open("xb") as out:
            shutil.copyfileobj(stream, out)
            left -= size
    apsw.hard_heap_limit(2 * limits.open_bytes)
    try:
        connection = apsw.Connection(str(copy))
        try:
            for _ in connection.execute("pragma journal_mode=delete"):  # this writes the log into the file
                pass
        finally:
            connection.close()
    except apsw.Error as error:
        raise DamagedError(reason(error)) from None
    return copy


def _sqlite_topic(connection: Any) -> Topic:
    encoding = {1: "ros2msg", 2: "ros2idl"}.get(connection.msgdef.format.value, "ros2msg")
    qos = tuple(dump_qos_v9(connection.ext.offered_qos_profiles))
    return Topic(
        str(connection.topic), str(connection.msgtype), connection.msgdef.data, connection.digest or "", qos, encoding
    )
