"""Shows a bag without a robot: plays it, and jumps to any time of it."""

from __future__ import annotations

import time
from bisect import bisect_right
from collections.abc import Iterator
from threading import Event, Lock
from typing import TYPE_CHECKING, Any

from ctrl_rl_bags import Bag, BagError, SerializedMessage
from ctrl_rl_bringup.view.reading import SceneReader
from ctrl_rl_bringup.view.scene import PERIOD_S, Scene
from ctrl_rl_bringup.view.value_slice import ValueSlice
from ctrl_rl_core import OccupancyMap, Robot

if TYPE_CHECKING:
    from ctrl_rl_bringup.view.page import Page

_BEFORE_NS = 2_000_000_000
"""Time before a jump's target from which on all messages are read: transforms come from several nodes [ns]."""
_LATCHED = frozenset(("/tf_static", "map", "path", "navigator/slice", "navigator/status", "safety_filter/set"))
"""Topics whose last message holds, however old."""


class Recording:
    """The scene at a time of a bag.

    Args:
        bag: Open bag.
        robot: Robot that was recorded.
        namespace: Namespace of the robot's topics.
        map_frame: Frame of the map.
        value: Slices of a value file, or None.
        map_: Map until the bag has one, or None.

    Attributes:
        scene: The scene.
        duration: Length of the bag [s].

    Raises:
        BagError: The bag has no topic that is shown, or is damaged.
    """

    def __init__(
        self,
        bag: Bag,
        robot: Robot,
        namespace: str = "",
        map_frame: str = "map",
        value: ValueSlice | None = None,
        map_: OccupancyMap | None = None,
    ) -> None:
        self.scene = Scene(map=map_)
        self._bag, self._value = bag, value
        self._reader = SceneReader(self.scene, robot, map_frame, value is None)
        prefix = f"/{namespace.strip('/')}/" if namespace.strip("/") else "/"
        full = {name if name.startswith("/") else f"{prefix}{name}": name for name in SceneReader.TOPICS}
        self._names = {topic: name for topic, name in full.items() if topic in bag.topics}
        if not self._names.keys() - {"/diagnostics"}:
            raise BagError(f"{bag.path} has none of the topics that are shown: {', '.join(sorted(full))}")
        self._types = bag.types(self._names)
        self._times: dict[str, list[int]] = {topic: [] for topic in self._names}
        for message in bag.messages(self._names):
            self._times[message.topic].append(message.log_time)
        self._begin, end = bag.info.start, bag.info.end
        self.duration = 1e-9 * (end - self._begin)
        self._ahead: Iterator[SerializedMessage] = iter(())
        self._next: SerializedMessage | None = None
        self._now = self._begin
        self.seek(0.0)

    @property
    def time(self) -> float:
        """Time since the start of the bag [s]."""
        return 1e-9 * (self._now - self._begin)

    def seek(self, seconds: float) -> None:
        """Show the scene at a time since the start [s]."""
        self._now = self._begin + round(1e9 * min(max(seconds, 0.0), self.duration))
        map_ = self.scene.map  # the same one is not drawn anew
        vars(self.scene).update(vars(Scene(map=map_)))
        self._reader.forget()
        for topic in sorted(self._names, key=lambda each: self._names[each] != "/tf_static"):
            if self._names[topic] in _LATCHED:
                self._read_last(topic)
        for message in self._bag.messages(self._names, self._now - _BEFORE_NS, self._now + 1):
            self._take(message)
        self._ahead = self._bag.messages(self._names, self._now + 1)
        self._next = next(self._ahead, None)
        self._finish()

    def advance(self, seconds: float) -> None:
        """Show what comes within some time [s]."""
        self._now = min(self._now + round(1e9 * seconds), self._begin + round(1e9 * self.duration))
        while self._next is not None and self._next.log_time <= self._now:
            self._take(self._next)
            self._next = next(self._ahead, None)
        self._finish()

    def _read_last(self, topic: str) -> None:
        """Read the last message up to now, and of static transforms all."""
        times = self._times[topic]
        last = bisect_right(times, self._now) - 1
        if last >= 0:
            first = 0 if self._names[topic] == "/tf_static" else last
            for message in self._bag.messages([topic], times[first], times[last] + 1):
                self._take(message)

    def _take(self, message: SerializedMessage) -> None:
        data: Any = self._types.decode(message.data, message.type)
        self._reader.take(self._names[message.topic], data, 1e-9 * message.log_time)

    def _finish(self) -> None:
        self._reader.update_pose()
        if self._value is not None:
            self.scene.value = self._value.at(self.scene.pose[2] if self.scene.pose else 0.0)


class Player:
    """Plays a recording on a page.

    Args:
        recording: The recording.
        page: The page.
    """

    def __init__(self, recording: Recording, page: Page) -> None:
        self._recording, self._page = recording, page
        self._playing, self._lock = True, Lock()
        self._target: float | None = None
        self._move = page.add_timeline(recording.duration, self._on_play, self._on_seek)

    def run(self, ended: Event) -> None:
        """Play until `ended` is set."""
        before = time.monotonic()
        while not ended.wait(PERIOD_S):
            now = time.monotonic()
            self.step(now - before)
            before = now

    def step(self, seconds: float) -> None:
        """Show the scene some time [s] later, or at the time that a visitor asked for."""
        recording = self._recording
        with self._lock:
            target, self._target = self._target, None
            playing = self._playing
        if target is not None:
            recording.seek(target)
        elif playing:
            recording.advance(seconds)
        if playing and recording.time >= recording.duration:
            self._on_play(False)
        self._move(recording.time, self._playing)
        self._page.draw(recording.scene)

    def _on_play(self, playing: bool) -> None:
        with self._lock:
            self._playing = playing
            if playing and self._recording.time >= self._recording.duration:
                self._target = 0.0

    def _on_seek(self, seconds: float) -> None:
        with self._lock:
            self._target = seconds
