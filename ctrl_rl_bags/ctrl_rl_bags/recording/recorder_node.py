"""Node that records a run: `ros2 run ctrl_rl_bags recorder --ros-args -p output:=runs/today`."""

from __future__ import annotations

import hashlib
import math
import re
import sys
import time
from contextlib import suppress

from ctrl_rl_core.io import FileError, open_file
from ctrl_rl_core.ros import Status, ok, warn
from rclpy.clock import Clock, ClockType

from ctrl_rl_bags.format.checks import BagError
from ctrl_rl_bags.format.writer import BagWriter
from ctrl_rl_bags.recording.recorder import ParameterCollector, TopicRecorder
from ctrl_rl_bags.recording.write_queue import BagQueue
from ctrl_rl_core import Parameter, ParameterError, SuiteNode, TaskError, load_task, run_node, task_digest

_DISCOVERY_S = 0.2
_PATIENCE_S = 4.0
"""Time limit for writing the queued messages when the recorder stops [s]."""


class RecorderNode(SuiteNode):
    """Records topics, the parameters of all nodes, and the digests of their files, in one bag."""

    QUICK = False
    FATAL = (BagError,)
    PARAMETERS = (
        Parameter("output", "", "Folder of the bag; empty: bag_<date>-<time> in the working folder.", kind="path"),
        Parameter("topics", [""], "Topics to record; empty: all, also those that appear later.", kind="name"),
        Parameter("exclude", [""], "Regular expressions of topics to exclude."),
        Parameter("include_hidden", False, "Record topics with a name part that begins with _ too."),
        Parameter("max_file_mb", 1000, "Size at which the next file starts [MB]; 0: one file.", 0, 1_000_000),
        Parameter("max_file_s", 0.0, "Time after which the next file starts [s]; 0: one file.", 0.0, 1e6),
        Parameter(
            "min_free_mb", 64, "Free disk space below which the recorder stops with a complete bag [MB].", 0, 1_000_000
        ),
        Parameter("queue_depth", 2000, "Queue depth of a topic in the middleware.", 1, 1_000_000),
        Parameter("max_queue_mb", 128, "Memory for messages waiting to be written [MB].", 1, 1_000_000),
        Parameter("digest_files", [""], "NAME=PATH: files (task, grid, policy) whose SHA-256 is stored in the bag."),
    )

    def __init__(self) -> None:
        super().__init__("recorder")
        digests = _digests(_texts(self.settings["digest_files"]))
        self._select = _Selection(
            {self.resolve_topic_name(name) for name in _texts(self.settings["topics"])},
            _patterns(_texts(self.settings["exclude"])),
            self.settings["include_hidden"],
        )
        self._writer = BagWriter(
            self.settings["output"] or time.strftime("bag_%Y_%m_%d-%H_%M_%S"),
            max_file_bytes=self.settings["max_file_mb"] * 1_000_000,
            max_file_s=self.settings["max_file_s"],
            min_free_bytes=self.settings["min_free_mb"] * 1_000_000,
        )
        self._queue = BagQueue(self._writer, self.settings["max_queue_mb"] * 1_000_000, self._say_dropped)
        for name, digest in digests.items():
            self._queue.set_custom_data(f"digest.{name}", digest)
        self._topics = TopicRecorder(self, self._queue, self._select, self.settings["queue_depth"])
        self._parameter_collector = ParameterCollector(self, self._queue)
        # One timer for all, because each wake-up of the executor costs as much as the work itself.
        self.create_timer(_DISCOVERY_S, self._discover, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._discover()
        self.get_logger().info(f"recording to {self._writer.folder}")

    def status(self) -> Status:
        """Report the numbers of written, lost and dropped messages."""
        skipped = ", ".join(self._topics.skipped)
        values = {
            "messages": self._writer.message_count,
            "lost": self._topics.lost,
            "dropped": self._queue.dropped.total(),
            "waiting_bytes": self._queue.waiting_bytes,
            "bytes": self._writer.bytes_received,
            "bytes_on_disk": self._writer.bytes_on_disk,
            "topics": len(self._writer.message_counts),
            "skipped_topics": skipped,
            "retyped_topics": ", ".join(self._topics.retyped.values()),
            "file": self._writer.file,
        }
        if self._topics.lost or self._queue.dropped or skipped:
            return warn("recording, not all of it", **values)
        if self._topics.retyped:
            return warn("recording; the type of a topic has changed", **values)
        return ok("recording", **values)

    def stop(self) -> None:
        """Finish the bag and log a one-line summary."""
        self._topics.drain()
        finished = True
        try:
            finished = self._queue.close(_PATIENCE_S)
        except BagError as error:
            self.get_logger().error(str(error))
        if not finished:
            self.get_logger().error(f"the disk does not respond: recover {self._writer.folder} with bag recover")
        count, used = self._writer.message_count, sum(count > 0 for count in self._writer.message_counts.values())
        dropped = f", {self._queue.dropped.total()} dropped" if self._queue.dropped else ""
        lost = f"{self._topics.lost} lost{dropped}"
        self.get_logger().info(f"{count} messages of {used} topics, {lost}, in {self._writer.folder}")

    def _say_dropped(self, name: str) -> None:
        self.get_logger().warning(f"{name}: messages are dropped, because they arrive faster than the disk can write")

    def _discover(self) -> None:
        self._queue.check()
        self._topics.discover()
        self._parameter_collector.discover()


class _Selection:
    """Selects the topics to record."""

    def __init__(self, names: set[str], exclude: list[re.Pattern[str]], hidden: bool) -> None:
        self._names = names
        self._exclude = exclude
        self._hidden = hidden

    def __call__(self, topic: str) -> bool:
        if self._names and topic not in self._names:
            return False
        if not self._hidden and topic not in self._names and "/_" in topic:
            return False
        return not any(pattern.fullmatch(topic) for pattern in self._exclude)


def _texts(values: list[str]) -> list[str]:
    """Drop empty texts: in ROS, [""] represents an empty list, which has no type otherwise."""
    return [value for value in values if value]


def _patterns(texts: list[str]) -> list[re.Pattern[str]]:
    try:
        return [re.compile(text) for text in texts]
    except re.error as error:
        raise ParameterError(f"parameter 'exclude': '{error.pattern!s}' is no regular expression: {error}") from None


def _digests(texts: list[str]) -> dict[str, str]:
    out = {}
    for text in texts:
        name, _, path = text.partition("=")
        if not name or not path:
            raise ParameterError(f"parameter 'digest_files': '{text}' must be NAME=PATH")
        try:
            with open_file(path, math.inf) as (file, _):
                out[name] = hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]
            if name == "task":  # a digest of the content, as for policies and grids, for comparison by bag readers
                with suppress(TaskError):
                    out[name] = task_digest(load_task(path))
        except OSError as error:
            raise ParameterError(f"parameter 'digest_files': {path} cannot be read ({error.strerror})") from None
        except FileError as error:
            raise ParameterError(f"parameter 'digest_files': {path} cannot be read: {error}") from None
    return out


def main() -> int:
    """Entry point of `ros2 run ctrl_rl_bags recorder`."""
    return run_node(RecorderNode)


if __name__ == "__main__":
    sys.exit(main())
