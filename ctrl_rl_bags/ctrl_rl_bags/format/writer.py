"""Writes rosbag2 folders: metadata.yaml and .mcap files with unchanged CDR bytes.

metadata.yaml marks a bag as complete, so it is written last. Until then, everything older than `flush_s` has been
passed to the operating system and survives a SIGKILL; fsync runs in a thread, so a slow SD card delays no message.
`recovery` reads incomplete bags.
"""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType

import yaml

from ctrl_rl_bags.format.checks import BagError
from ctrl_rl_bags.format.mcap_writer import CHUNK_BYTES, McapFile
from ctrl_rl_bags.format.metadata import CUSTOM_DATA_RECORD, FileSummary, Topic, bag_information, write_metadata

FLUSH_S = 0.25


class BagWriter:
    """Writes one bag; as a context manager, finishes the bag even after an exception.

    Args:
        folder: Folder of the bag, created with its parents; must not exist.
        max_file_bytes: Approximate file size at which the next file starts; 0 for one file.
        max_file_s: Span of log time after which the next file starts [s]; 0 for one file.
        chunk_bytes: Uncompressed size of a chunk, the unit in which messages are compressed.
        flush_s: Maximum time a message stays in this process [s], if `flush_if_due` is called at least as often.
        min_free_bytes: Free disk space below which writing ends with a BagError and a complete bag [bytes].

    Raises:
        BagError: The folder exists or cannot be created.
    """

    def __init__(
        self,
        folder: Path | str,
        *,
        max_file_bytes: int = 0,
        max_file_s: float = 0.0,
        chunk_bytes: int = CHUNK_BYTES,
        flush_s: float = FLUSH_S,
        min_free_bytes: int = 0,
    ) -> None:
        self.folder = Path(folder)
        self.bytes_received = 0
        self._max_bytes = max_file_bytes
        self._max_ns = int(max_file_s * 1e9)
        self._chunk_bytes = chunk_bytes
        self._flush_s = flush_s
        self._min_free_bytes = min_free_bytes
        self._topics: dict[str, Topic] = {}
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._custom_data = {"written_by": "ctrl_rl_core"}
        self._finished: list[FileSummary] = []
        self._finished_counts: dict[str, int] = {}
        self._finished_bytes = 0
        self._open: McapFile | None = None
        self._closed = False
        self._first_time: int | None = None
        self._flush_due = time.monotonic() + flush_s
        self._syncing: Future[None] | None = None
        self._synced = 0
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError:
            raise BagError(f"{self.folder} exists: a bag is never overwritten; name another folder") from None
        except OSError as error:
            raise BagError(f"{self.folder} cannot be made: {error.strerror}") from None
        self._disk = ThreadPoolExecutor(1, thread_name_prefix="bag_sync")
        self._next_file()

    @property
    def file(self) -> Path:
        """The current file."""
        return self._file.path

    @property
    def _file(self) -> McapFile:
        assert self._open is not None
        return self._open

    @property
    def bytes_on_disk(self) -> int:
        """Total size of all files so far [bytes]."""
        return self._finished_bytes + self._file.size

    @property
    def message_counts(self) -> Mapping[str, int]:
        """Number of messages written, by topic, including topics without messages."""
        return self._counts

    @property
    def message_count(self) -> int:
        """Number of messages written."""
        return sum(self._counts.values())

    def add_topic(self, topic: Topic) -> None:
        """Add a topic, once, before its first message.

        Raises:
            BagError: The topic already exists, or writing fails.
        """
        if topic.name in self._topics:
            raise BagError(f"{self.folder}: topic {topic.name} was added twice")
        try:
            self._channels[topic.name] = self._file.add_topic(topic)
        except OSError as error:
            raise self._disk_error(error) from None
        self._topics[topic.name] = topic
        self._counts[topic.name] = 0

    def write(
        self,
        topic: str,
        data: bytes | bytearray | memoryview,
        log_time: int,
        publish_time: int | None = None,
        sequence: int = 0,
    ) -> None:
        """Write one message.

        Args:
            topic: Topic name registered with `add_topic`.
            data: CDR bytes with their 4-byte header; stored as they are.
            log_time: Reception time [ns since the epoch].
            publish_time: Publication time [ns since the epoch]; the log time if None.
            sequence: Publisher's sequence number, below 2**32; 0 if there is none.

        Raises:
            BagError: The topic is unknown, a time is negative, or writing fails.
        """
        try:
            channel = self._channels[topic]
        except KeyError:
            raise BagError(f"{self.folder}: no topic {topic} was added to the bag") from None
        file = self._file
        try:
            if self._first_time is None:
                self._first_time = log_time
            elif (self._max_ns and log_time - self._first_time >= self._max_ns) or (
                self._max_bytes and file.size >= self._max_bytes
            ):
                self._next_file()
                file, channel, self._first_time = self._file, self._channels[topic], log_time
            file.write(
                channel, data, log_time, log_time if publish_time is None else publish_time, sequence & 0xFFFFFFFF
            )
        except OSError as error:
            raise self._disk_error(error) from None
        except struct.error:
            raise BagError(f"{topic}: times must be 0 to 2**64 ns, not {log_time} and {publish_time}") from None
        self._counts[topic] += 1
        self.bytes_received += len(data)
        if time.monotonic() >= self._flush_due:
            self.flush()

    def set_custom_data(self, key: str, value: str) -> None:
        """Store a text with the bag: immediately in the file, and in metadata.yaml on closing."""
        self._custom_data[key] = value
        try:
            self._file.add_metadata(CUSTOM_DATA_RECORD, {key: value})
        except OSError as error:
            raise self._disk_error(error) from None

    def flush_if_due(self) -> None:
        """Flush if `flush_s` has passed since the last flush; call it from a timer, in case topics fall silent."""
        if time.monotonic() >= self._flush_due:
            self.flush()

    def flush(self) -> None:
        """Pass everything to the operating system and have a thread call fsync.

        Raises:
            BagError: Writing fails, or less than `min_free_bytes` of disk space is left.
        """
        self._flush_due = time.monotonic() + self._flush_s
        try:
            self._file.flush()
            written = self.bytes_on_disk
            if self._syncing is not None and self._syncing.done():
                self._syncing.result()
                self._syncing = None
            if self._syncing is None and written != self._synced:
                self._syncing, self._synced = self._disk.submit(os.fsync, self._file.fileno()), written
            if self._min_free_bytes:
                disk = os.statvfs(self.folder)
                free = disk.f_bavail * disk.f_frsize
        except OSError as error:
            raise self._disk_error(error) from None
        if self._min_free_bytes and free < self._min_free_bytes:
            raise BagError(f"{self.folder}: stopped with only {free >> 20} MiB left on the disk; the bag can be read")

    def close(self) -> None:
        """Finish the bag; further calls do nothing.

        Raises:
            BagError: Writing fails; `bag recover` then finds everything that reached the disk.
        """
        if self._closed:
            return
        self._closed = True
        failure: OSError | None = None
        try:
            try:
                self._file.flush()
            except OSError as error:  # these messages are lost, but the content on disk may still be finished
                failure = error
            self._finish_file()
            write_metadata(self.folder, self._information(self._finished, self._finished_counts))
        except OSError as error:
            failure = failure or error
        self._disk.shutdown()
        self._file.abort()
        if failure is not None:
            raise self._disk_error(failure) from None

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _next_file(self) -> None:
        if self._open is not None:
            self._finish_file()
        path = self.folder / f"{self.folder.name}_{len(self._finished)}.mcap"
        try:
            file = McapFile(path, self._chunk_bytes)
        except OSError as error:
            raise self._disk_error(error) from None
        self._open = file
        file.add_metadata(CUSTOM_DATA_RECORD, self._custom_data)
        self._channels = {name: file.add_topic(topic) for name, topic in self._topics.items()}

    def _finish_file(self) -> None:
        """Finish the open file and keep only its summary."""
        file = self._file
        file.flush()
        summary = FileSummary(file.path.name, file.start, file.end, file.message_count)
        # rosbag2 reads this record when a single file is opened without its folder.
        information = self._information([summary], file.message_counts)
        text = yaml.safe_dump(information, sort_keys=False, allow_unicode=True)
        file.add_metadata("rosbag2", {"serialized_metadata": text})
        file.finish()
        self._finished.append(summary)
        self._finished_bytes += file.size
        for name, count in file.message_counts.items():
            self._finished_counts[name] = self._finished_counts.get(name, 0) + count
        self._syncing = self._disk.submit(file.close)

    def _information(self, files: list[FileSummary], counts: Mapping[str, int]) -> dict[str, object]:
        return bag_information(files, self._topics.values(), counts, self._custom_data)

    def _disk_error(self, error: OSError) -> BagError:
        return BagError(
            f"{self.file}: cannot be written ({error.strerror}); free some space. If the folder has no metadata.yaml, "
            f"recover it: ros2 run ctrl_rl_bags bag recover {self.folder}"
        )
