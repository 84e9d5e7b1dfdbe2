"""Frames from bags, as a stream: a bag of any length takes the memory of a thousand frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from ctrl_rl_core.driving.scan import ScanError
from numpy.typing import NDArray

from ctrl_rl_bags.datasets.episodes import EpisodeFrames, Step
from ctrl_rl_bags.datasets.frames import CommandType, Frames, ImageLayout, Layout
from ctrl_rl_bags.datasets.readings import (
    ScanColumn,
    no_goal,
    read_command,
    read_goal,
    read_image,
    read_odometry,
    stamp_of,
)
from ctrl_rl_bags.datasets.wiring import ExtractionOptions, find_task, find_topics
from ctrl_rl_bags.format.checks import BagError, DamagedError, fields_of, printable
from ctrl_rl_bags.format.reader import Bag, open_bag
from ctrl_rl_bags.format.topics import SerializedMessage

_OLDEST_NS = 10**9
"""Commands and odometry older than this do not count: a base stops without them."""
_PERIODS = 200
"""Scans that the period of a dataset is taken from."""


@dataclass
class Found:
    """What an extraction found, for its report.

    Attributes:
        missing: Topics that the bags lack, with what is missing for that.
        left_out: Scans that are in no frame.
        bytes: Size of the messages read.
    """

    missing: set[str] = field(default_factory=set)
    left_out: int = 0
    bytes: int = 0


def find_layout(bag: Path | str, options: ExtractionOptions) -> Layout:
    """Return the layout of a dataset whose first bag is this.

    Raises:
        BagError: The bag cannot be read, or lacks scans, odometry or commands.
    """
    with open_bag(bag) as opened:
        wiring = find_topics(opened, options)
        types = opened.types(wiring.topics.values())
        scans, stamps, image = ScanColumn(options.beams), list[int](), None
        wanted = [wiring.topics[name] for name in ("scan", "image") if name in wiring.topics]
        for message in opened.messages(wanted):
            with fields_of(f"{bag}: a message of {message.topic}"):
                data = _decode(types, message, opened)
                if message.topic == wiring.topics.get("image"):
                    if image is None:
                        height, width, _ = read_image(data, None, f"{bag}: the first picture").shape
                        image = ImageLayout(height=height, width=width)
                else:
                    with suppress(ScanError):
                        scans.read(data, f"{bag}: a scan")
                        stamps.append(message.log_time)
            if len(stamps) > _PERIODS and (image is not None or "image" not in wiring.topics):
                break
        if scans.layout is None or len(stamps) < 2:
            raise BagError(f"{bag}: {wiring.topics['scan']} has no two usable scans")
        digests = {key: printable(text) for key, text in opened.info.custom_data.items() if key.startswith("digest.")}
        return Layout(
            command=cast(CommandType, wiring.command),
            command_topic=wiring.command_topic,
            scan=scans.layout,
            image=image,
            goal="goal_pose" in wiring.topics,
            reward="reward" in wiring.topics,
            task=printable(options.task or opened.info.custom_data.get("task", "") or find_task(opened)),
            period=max(float(np.median(np.diff(stamps))) * 1e-9, 1e-6),
            digests=digests,
        )


def extract(
    bags: Sequence[Path | str],
    layout: Layout,
    options: ExtractionOptions,
    found: Found,
    tell: Callable[[int], object] = lambda _: None,
) -> Iterator[Frames]:
    """Yield the frames of bags, a piece of an episode at a time.

    A frame is a scan with the last odometry, goal and picture received before it. Its action is the last command
    received before the next scan; `next.reward` and `next.outcome` are the last received before that scan. An episode
    ends at an outcome, where the episode's number changes, and where scans, odometry or commands pause for a second.

    Args:
        bags: Bags in the order of the episodes.
        layout: Layout of the dataset, from `find_layout`.
        options: Names of the topics, and beams of the scans.
        found: Filled in with what was missing.
        tell: Told the number of messages read since the last call.

    Raises:
        BagError: A bag cannot be read, or does not fit the layout.
    """
    episode = 0
    for source, bag in enumerate(bags):
        with open_bag(bag) as opened:
            for frames in _Extraction(opened, layout, options, found, tell).frames():
                yield replace(frames, episode=episode, source=source)
                episode += frames.last


class _Extraction:
    """Goes through one bag."""

    def __init__(
        self, bag: Bag, layout: Layout, options: ExtractionOptions, found: Found, tell: Callable[[int], object]
    ) -> None:
        self._bag, self._layout, self._found, self._tell = bag, layout, found, tell
        self._wiring = find_topics(bag, options)
        if self._wiring.command != layout.command:
            raise BagError(f"{bag.path}: its commands are {self._wiring.command}, those before {layout.command}")
        for name, what in (("goal_pose", "goal"), ("reward", "reward"), ("image", "picture")):
            if name not in self._wiring.topics:
                found.missing.add(f"no {options.topic(name)}: no {what}s")
        self._types = bag.types(self._wiring.topics.values())
        self._scans = ScanColumn(options.beams, layout.scan)
        self._latest: dict[str, SerializedMessage] = {}
        self._episode: tuple[int, int] = (0, 0)

    def frames(self) -> Iterator[Frames]:
        """Yield the frames of the bag."""
        names = {topic: name for name, topic in self._wiring.topics.items()}
        current, count = EpisodeFrames(self._layout), 0
        for message in self._bag.messages(names):
            self._found.bytes += len(message.data)
            count += 1
            if count == 1000:
                self._tell(count)
                count = 0
            name = names[message.topic]
            if name == "episode":
                yield from self._take_episode(message, current)
            elif name != "scan":
                self._latest[name] = message
            else:
                yield from self._take_scan(message, current)
        current.mark(self._episode[1])
        yield from current.end()
        self._found.left_out += current.left_out
        self._tell(count)

    def _take_episode(self, message: SerializedMessage, current: EpisodeFrames) -> Iterator[Frames]:
        status = self._read(message, lambda data: (int(data.episode), int(data.outcome.value)))
        if status[0] != self._episode[0]:
            current.mark(self._episode[1])
            yield from current.end()
            for name in ("command", "reward"):
                self._latest.pop(name, None)
        self._episode = status

    def _take_scan(self, message: SerializedMessage, current: EpisodeFrames) -> Iterator[Frames]:
        step = self._step(message)
        if step is None or (current.time is not None and not 0 < message.log_time - current.time < _OLDEST_NS):
            yield from current.end()
        if step is None or (step.outcome and not len(current)):  # unusable, or the episode is over
            self._found.left_out += 1
            return
        yield from current.add(step)
        if step.outcome:
            yield from current.end()

    def _step(self, message: SerializedMessage) -> Step | None:
        """Return what is known at a scan; None where scan, odometry or command are unusable or too old."""
        odometry = self._recent("odom", message.log_time, read_odometry)
        command = self._recent("command", message.log_time, lambda data: read_command(data, self._layout.command))
        what = f"{self._bag.path}: a scan"
        try:
            stamp, ranges = self._read(message, lambda data: (stamp_of(data), self._scans.read(data, what)))
        except ScanError:
            return None
        if odometry is None:
            return None
        goal, image = self._latest.get("goal_pose"), self._latest.get("image")
        picture = None
        if self._layout.image is not None:
            if image is None:
                return None
            picture = self._read(image, lambda data: read_image(data, self._layout.image, f"{what}'s picture"))
        reward, outcome = self._reward()
        return Step(
            stamp=stamp,
            time=message.log_time,
            scan=ranges,
            odometry=odometry,
            goal=no_goal() if goal is None else self._read(goal, read_goal),
            image=picture,
            command=command,
            reward=reward,
            outcome=self._episode[1] if "episode" in self._wiring.topics else outcome,
        )

    def _reward(self) -> tuple[float, int]:
        message = self._latest.get("reward")
        if message is None:
            return math.nan, 0
        return self._read(message, lambda data: (float(data.reward), int(data.outcome.value)))

    def _recent(
        self, name: str, now: int, read: Callable[[Any], NDArray[np.float64] | None]
    ) -> NDArray[np.float64] | None:
        message = self._latest.get(name)
        return None if message is None or now - message.log_time > _OLDEST_NS else self._read(message, read)

    def _read(self, message: SerializedMessage, read: Callable[[Any], Any]) -> Any:
        with fields_of(f"{self._bag.path}: a message of {printable(message.topic)}"):
            return read(_decode(self._types, message, self._bag))


def _decode(types: Any, message: SerializedMessage, bag: Bag) -> Any:
    try:
        return types.decode(message.data, message.type)
    except DamagedError as error:
        raise BagError(f"{bag.path}: a message of {printable(message.topic)} cannot be decoded: {error}") from None
