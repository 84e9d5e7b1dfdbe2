"""Streams frames from bags; a bag of any length needs memory for a thousand frames and one row per scan."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_bags.datasets.episodes import EpisodeFrames, Step
from ctrl_rl_bags.datasets.frames import CommandType, Frames, ImageLayout, Layout
from ctrl_rl_bags.datasets.options import ExtractionOptions, find_task, find_topics
from ctrl_rl_bags.datasets.readings import ScanColumn, read_image, stamp_of
from ctrl_rl_bags.datasets.timeline import Timeline, read_timeline
from ctrl_rl_bags.format.checks import BagError, DamagedError, fields_of, printable
from ctrl_rl_bags.format.metadata import SerializedMessage
from ctrl_rl_bags.format.reader import Bag, open_bag
from ctrl_rl_core import ScanError

_PERIODS = 200
"""Number of scans used to measure a dataset's period."""
_MOST_NOTES = 100
_TOLD = 1000
"""Number of scans between two progress reports."""


@dataclass
class Found:
    """Findings of an extraction, for the report.

    Attributes:
        missing: Topics missing in the bags, and the resulting gaps in the frames.
        left_out: Number of scans in no frame.
        notes: Lines about omitted messages and split drives.
        delays: Median time from a scan to the next command, per bag [s].
        periods: Median time between scans, per bag [s].
        bytes: Total size of the messages read [bytes].
    """

    missing: set[str] = field(default_factory=set)
    left_out: int = 0
    notes: list[str] = field(default_factory=list)
    delays: list[float] = field(default_factory=list)
    periods: list[float] = field(default_factory=list)
    bytes: int = 0

    def note(self, line: str) -> None:
        """Add a line, unless it is a duplicate or there are too many."""
        if len(self.notes) < _MOST_NOTES and line not in self.notes:
            self.notes.append(line)

    @property
    def why_nothing(self) -> str:
        """Return why the bags contain no drive, for the end of an error message."""
        told = f" ({self.notes[0]})" if self.notes else ""
        return f"no two scans with odometry and a command between: was the robot driven?{told}"


def find_layout(bag: Path | str, options: ExtractionOptions) -> Layout:
    """Derive a dataset's layout from its first bag.

    Raises:
        BagError: The bag cannot be read, or lacks scans, odometry or commands.
    """
    with open_bag(bag) as opened:
        wiring = find_topics(opened, options)
        types = opened.types(wiring.topics.values())
        scans, image, refused = ScanColumn(options.beams), None, ""
        stamps, received = list[int](), list[int]()
        wanted = [wiring.topics[name] for name in ("scan", "image") if name in wiring.topics]
        for message in opened.messages(wanted):
            with fields_of(f"{bag}: a message of {printable(message.topic)}"):
                data = _decode(types, message, opened)
                if message.topic == wiring.topics.get("image"):
                    if image is None:
                        height, width, _ = read_image(data, None, f"{bag}: the first picture").shape
                        image = ImageLayout(height=height, width=width)
                else:
                    try:
                        scans.read(data, f"{bag}: a scan")
                    except ScanError as error:
                        refused = refused or f": {error}"
                    else:
                        stamps.append(stamp_of(data))
                        received.append(message.log_time)
            if len(stamps) > _PERIODS and (image is not None or "image" not in wiring.topics):
                break
        if scans.layout is None or len(stamps) < 2:
            raise BagError(f"{bag}: {printable(wiring.topics['scan'])} has no two usable scans{refused}")
        digests = {key: printable(text) for key, text in opened.info.custom_data.items() if key.startswith("digest.")}
        times = stamps if np.median(np.diff(stamps)) > 0.0 else received
        return Layout(
            command=cast(CommandType, wiring.command),
            command_topic=wiring.command_topic,
            scan=scans.layout,
            image=image,
            goal="goal_pose" in wiring.topics,
            reward="reward" in wiring.topics,
            task=printable(options.task or opened.info.custom_data.get("task", "") or find_task(opened)),
            period=options.period or max(float(np.median(np.diff(times))) * 1e-9, 1e-6),
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

    A frame is a scan with the odometry, goal and image at its time. Its action is the command acting until the next
    frame, whose reward and outcome are `next.reward` and `next.outcome`. Times are message stamps, or reception times
    without stamps (`ctrl_rl_bags.alignment`). An episode ends at an outcome or a new episode number, at an odometry
    jump or clock reset, and when scans, odometry or commands pause for a second.

    Args:
        bags: Bags in episode order.
        layout: Layout of the dataset, from `find_layout`.
        options: Topic names, beams of the scans, clock, and step length.
        found: Receives the findings.
        tell: Called with the number of messages read since the last call.

    Raises:
        BagError: A bag cannot be read, does not fit the layout, or its topics have different clocks.
    """
    episode = 0
    for source, bag in enumerate(bags):
        with open_bag(bag) as opened:
            for frames in _Extraction(opened, layout, options, found, tell).frames():
                yield replace(frames, episode=episode, source=source)
                episode += frames.last


class _Extraction:
    """Extracts the frames of one bag."""

    def __init__(
        self, bag: Bag, layout: Layout, options: ExtractionOptions, found: Found, tell: Callable[[int], object]
    ) -> None:
        self._bag, self._layout, self._options, self._found, self._tell = bag, layout, options, found, tell
        self._wiring = find_topics(bag, options)
        if self._wiring.command != layout.command:
            raise BagError(
                f"{bag.path}: its commands are {self._wiring.command}, but those of earlier bags {layout.command}"
            )
        for name, what in (("goal_pose", "goal"), ("reward", "reward"), ("image", "picture")):
            if name not in self._wiring.topics:
                found.missing.add(f"no {options.topic(name)}: no {what}s")
        self._types = bag.types(self._wiring.topics.values())
        self._scans = ScanColumn(options.beams, layout.scan)

    def frames(self) -> Iterator[Frames]:
        """Yield the frames of the bag."""
        found, bag = self._found, self._bag
        pictures = self._layout.image is not None
        if pictures and "image" not in self._wiring.topics:
            raise BagError(f"{bag.path}: it has no images, but the first bag has")
        before = bag.bytes_read
        for note in bag.info.notes:
            found.note(f"{bag.path}: {note}")
        read = read_timeline(bag, self._wiring, self._options, pictures, found.note)
        found.bytes += bag.bytes_read - before
        self._tell(sum(bag.info.topics[topic].message_count for topic in self._wiring.topics.values()) - read.scans)
        found.left_out += read.left_out
        found.delays.append(read.delay)
        found.periods.append(read.period)
        if read.beams[0] != read.beams[1]:
            found.note(
                f"{bag.path}: its scans have {read.beams[0]} to {read.beams[1]} beams: all are brought to "
                f"{self._layout.scan.beams}"
            )
        if not read.parts:
            return
        yield from self._with_scans(Timeline.joined(read.parts))

    def _with_scans(self, timeline: Timeline) -> Iterator[Frames]:
        """Yield the frames of a timeline, reading scan by scan."""
        current, row, count = EpisodeFrames(self._layout), 0, 0
        picture: tuple[int, NDArray[np.uint8] | None] = (0, None)
        scan, image = self._wiring.topics["scan"], self._wiring.topics.get("image", "")
        wanted = set(timeline.pictures.tolist())
        for message in self._bag.messages([scan, image] if self._layout.image is not None else [scan]):
            count += message.topic == scan
            if count == _TOLD:
                self._tell(count)
                count = 0
            if message.topic == image:
                if message.log_time in wanted:
                    picture = message.log_time, self._read(message, self._picture)
                continue
            if row == len(timeline) or message.log_time != timeline.log[row]:
                continue
            stamp, ranges = self._read(message, self._scan)
            if stamp != timeline.stamps[row]:
                continue
            if timeline.begins[row]:
                yield from current.end()
            yield from current.add(_step(timeline, row, ranges, picture[1]))
            row += 1
        yield from current.end()
        self._tell(count)
        if row < len(timeline):
            raise BagError(f"{self._bag.path}: its scans are not in the order of their stamps: --clock log")

    def _picture(self, data: Any) -> NDArray[np.uint8]:
        return read_image(data, self._layout.image, f"{self._bag.path}: a picture")

    def _scan(self, data: Any) -> tuple[int, NDArray[np.float32]]:
        return stamp_of(data), self._scans.read(data, f"{self._bag.path}: a scan")

    def _read(self, message: SerializedMessage, read: Callable[[Any], Any]) -> Any:
        with fields_of(f"{self._bag.path}: a message of {printable(message.topic)}"):
            return read(_decode(self._types, message, self._bag))


def _step(timeline: Timeline, row: int, ranges: NDArray[np.float32], picture: NDArray[np.uint8] | None) -> Step:
    return Step(
        stamp=int(timeline.stamps[row]),
        time=int(timeline.log[row]),
        scan=ranges,
        odometry=timeline.odometry[row],
        goal=timeline.goals[row],
        image=picture,
        command=None if timeline.begins[row] else timeline.commands[row],
        reward=float(timeline.rewards[row]),
        outcome=int(timeline.outcomes[row]),
    )


def _decode(types: Any, message: SerializedMessage, bag: Bag) -> Any:
    try:
        return types.decode(message.data, message.type)
    except DamagedError as error:
        raise BagError(f"{bag.path}: a message of {printable(message.topic)} cannot be decoded: {error}") from None
