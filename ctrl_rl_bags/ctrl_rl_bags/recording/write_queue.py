"""A bounded queue written to a bag by a thread, so that a slow disk neither delays callbacks nor fills the memory.

Messages that do not fit are dropped and counted.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable

from ctrl_rl_bags.format.checks import BagError
from ctrl_rl_bags.format.metadata import Topic
from ctrl_rl_bags.format.writer import FLUSH_S, BagWriter

_OVERHEAD = 200
"""Memory of an entry besides its message [bytes]."""


class BagQueue:
    """Passes messages to its own `BagWriter`, of which other code may only read the counts.

    Args:
        writer: Writer of the bag, used by one thread.
        max_bytes: Maximum memory of the queue [bytes].
        on_drop: Called with the topic name when the first message of a topic is dropped.

    Attributes:
        dropped: Number of messages dropped, by topic.
    """

    def __init__(self, writer: BagWriter, max_bytes: int, on_drop: Callable[[str], None] = lambda _topic: None) -> None:
        self.dropped: Counter[str] = Counter()
        self._writer = writer
        self._max_bytes = max_bytes
        self._on_drop = on_drop
        self._waiting: deque[tuple[str, int, Callable[[], None]]] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self._deadline = float("inf")
        self._closing = False
        self._error: BagError | None = None
        # A disk that never responds must not block the process.
        self._thread = threading.Thread(target=self._work, name="bag_writer", daemon=True)
        self._thread.start()

    @property
    def waiting_bytes(self) -> int:
        """Memory of the queued messages [bytes]."""
        return self._bytes

    def add_topic(self, topic: Topic) -> None:
        """Add a topic before its first message."""
        self._put("", 0, lambda: self._writer.add_topic(topic))

    def set_custom_data(self, key: str, value: str) -> None:
        """Store a text with the bag."""
        self._put(key, len(value), lambda: self._writer.set_custom_data(key, value))

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int, sequence: int) -> None:
        """Queue a message, or drop it if the queue is full."""
        self._put(topic, len(data), lambda: self._writer.write(topic, data, log_time, publish_time, sequence))

    def check(self) -> None:
        """Raise the error that stopped writing, if any.

        Raises:
            BagError: Writing failed.
        """
        if self._error is not None:
            raise self._error

    def close(self, patience: float) -> bool:
        """Write queued messages for at most `patience` [s], drop the rest, and finish the bag.

        Returns:
            Whether the bag is finished; False if the disk does not respond for twice that time.

        Raises:
            BagError: Writing fails.
        """
        with self._changed:
            self._closing, self._deadline = True, time.monotonic() + patience
            self._changed.notify()
        self._thread.join(2.0 * patience)
        if self._thread.is_alive():
            return False
        self.check()
        return True

    def _put(self, name: str, size: int, act: Callable[[], None]) -> None:
        size += _OVERHEAD
        with self._changed:
            if name and self._bytes + size > self._max_bytes:
                self.dropped[name] += 1
                first = self.dropped[name] == 1
            else:
                self._waiting.append((name, size, act))
                self._bytes += size
                self._changed.notify()
                return
        if first:
            self._on_drop(name)

    def _work(self) -> None:
        """Write queued messages, flushing when due, until the queue closes or an error occurs; finish the bag."""
        try:
            while self._step():
                pass
        except BagError as error:
            self._error = error
        with self._changed:
            self._drop_waiting()
        try:
            self._writer.close()
        except BagError as error:
            self._error = self._error or error

    def _step(self) -> bool:
        with self._changed:
            if not self._waiting and not self._closing:
                self._changed.wait(FLUSH_S / 2)
            if self._closing and (not self._waiting or time.monotonic() > self._deadline):
                return False
            entry = self._waiting.popleft() if self._waiting else None
        if entry is None:
            self._writer.flush_if_due()
            return True
        _, size, act = entry
        try:
            act()
        finally:
            with self._changed:
                self._bytes -= size
        return True

    def _drop_waiting(self) -> None:
        for name, _, _ in self._waiting:
            if name:
                self.dropped[name] += 1
        self._waiting.clear()
        self._bytes = 0
