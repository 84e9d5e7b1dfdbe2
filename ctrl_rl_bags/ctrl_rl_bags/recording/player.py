"""Plays a bag: publishes the recorded bytes at the recorded times; latched topics stay latched."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rclpy
from ctrl_rl_core.processes import handle_signals
from rclpy._rclpy_pybind11 import RCLError
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from tqdm import tqdm

from ctrl_rl_bags.format.bag_info import BagInfo
from ctrl_rl_bags.format.checks import BagError, printable, reason
from ctrl_rl_bags.format.mcap_records import DEFAULT_LIMITS, Limits
from ctrl_rl_bags.format.metadata import SerializedMessage
from ctrl_rl_bags.format.reader import bag_info, read_raw
from ctrl_rl_bags.recording.message_types import UnknownTypeError, message_class
from ctrl_rl_bags.recording.qos import is_latched, publisher_qos

_DEPTH = 1000
_LATCHED_DEPTH = 100
"""Depth of latched topics, enough for every node's /tf_static; the middleware does not report the recorded depth."""
_LONGEST_NS = 86_400 * 10**9
"""Gaps longer than this are skipped [ns]."""
_CLOCK_HZ = 100.0
_SETTLE_S = 0.2
_ACKNOWLEDGE_S = 2.0


@dataclass(frozen=True)
class PlaybackOptions:
    """Settings of a replay.

    Attributes:
        rate: Speed as a multiple of the recording's.
        topics: Names of the topics to play; all if empty.
        remap: New topic names by old names.
        loop: Whether to restart at the end, until stopped.
        clock: Whether to publish the bag's time on /clock at 100 Hz, in place of a recorded clock.
        start_offset: Time to skip at the start of the bag [s].
        wait: Maximum time to wait for a subscriber on every topic before the first message [s].
        limits: Memory limits.
    """

    rate: float = 1.0
    topics: Sequence[str] = ()
    remap: Mapping[str, str] = field(default_factory=dict)
    loop: bool = False
    clock: bool = False
    start_offset: float = 0.0
    wait: float = 1.0
    limits: Limits = DEFAULT_LIMITS


def play(bag: Path | str, how: PlaybackOptions, warn: Callable[[str], None], *, progress: bool = False) -> int:
    """Play a bag until its end, SIGINT or SIGTERM, and return the number of messages published.

    Args:
        bag: Folder or file.
        how: Settings of the replay.
        warn: Called with a line about each topic that cannot be played.
        progress: Whether to show a progress bar on a terminal.

    Raises:
        BagError: The bag cannot be read, a value is out of range, or no topic can be played.
    """
    info = bag_info(bag, how.limits)
    _check(info, how)
    stop = threading.Event()
    with handle_signals(lambda *_: stop.set()):
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        node = Node("bag_player", start_parameter_services=False)
        try:
            return _Player(node, info, how, stop, warn).run(progress)
        finally:
            node.destroy_node()
            rclpy.try_shutdown()


class _Player:
    def __init__(
        self, node: Node, info: BagInfo, how: PlaybackOptions, stop: threading.Event, warn: Callable[[str], None]
    ) -> None:
        self._info = info
        self._how = how
        self._stop, self._warn = stop, warn
        self._publishers = _publishers(node, info, how, warn)
        self._clock = node.create_publisher(Clock, "/clock", 1) if how.clock else None

    def run(self, progress: bool) -> int:
        self._wait_for_subscribers()
        count = 0
        with tqdm(
            total=round((self._info.end - self._first) * 1e-9, 3),
            desc=self._info.folder.name,
            unit="s",
            bar_format="{desc}: {percentage:3.0f}%|{bar}| {n:.1f}/{total:.1f} s",
            disable=None if progress else True,
        ) as bar:
            while not self._stop.is_set():
                bar.reset()
                for message in self._in_rhythm():
                    self._publishers[message.topic].publish(message.data)
                    count += 1
                    bar.update((message.log_time - self._first) * 1e-9 - bar.n)
                if not self._how.loop:
                    break
        self._wait_for_acknowledgements()
        return count

    @property
    def _first(self) -> int:
        return self._info.start + int(self._how.start_offset * 1e9)

    def _messages(self) -> Iterator[SerializedMessage]:
        """Yield the messages to play, starting with earlier latched ones, as a late subscriber would receive."""
        if self._how.start_offset > 0.0:
            latched = [name for name in self._publishers if is_latched(self._info.topics[name].qos)]
            if latched:
                yield from read_raw(self._info.folder, latched, stop=self._first, limits=self._how.limits)
        start = self._first if self._how.start_offset > 0.0 else None
        yield from read_raw(self._info.folder, list(self._publishers), start=start, limits=self._how.limits)

    def _in_rhythm(self) -> Iterator[SerializedMessage]:
        """Yield each message when it is due, and publish /clock in between, until stopped."""
        begin = time.monotonic()
        tick = begin
        skipped, before = 0, self._first
        for message in self._messages():
            gap, before = message.log_time - before, max(before, message.log_time)
            if gap > _LONGEST_NS:  # the first messages of a simulation may have time 0
                self._warn(f"{gap * 1e-9:.0f} s without messages are skipped")
                skipped += gap
            due = begin + max(0, message.log_time - self._first - skipped) * 1e-9 / self._how.rate
            while not self._stop.is_set():
                now = time.monotonic()
                if self._clock is not None and now >= tick:
                    bag_time = Time(nanoseconds=self._first + skipped + int((now - begin) * self._how.rate * 1e9))
                    self._clock.publish(Clock(clock=bag_time.to_msg()))
                    tick = now + 1.0 / _CLOCK_HZ
                if now >= due:
                    break
                self._stop.wait(min(due, tick) - now if self._clock is not None else due - now)
            if self._stop.is_set():
                return
            yield message

    def _wait_for_subscribers(self) -> None:
        end = time.monotonic() + self._how.wait
        while time.monotonic() < end and not self._stop.is_set():
            if all(publisher.get_subscription_count() for publisher in self._publishers.values()):
                # The other side discovers the publisher slightly later, and misses earlier messages.
                self._stop.wait(_SETTLE_S)
                return
            self._stop.wait(0.02)

    def _wait_for_acknowledgements(self) -> None:
        end = time.monotonic() + _ACKNOWLEDGE_S
        for publisher in self._publishers.values():
            left = 0.1 if self._stop.is_set() else max(0.0, end - time.monotonic())
            publisher.wait_for_all_acked(Duration(nanoseconds=int(left * 1e9)))


def _publishers(node: Node, info: BagInfo, how: PlaybackOptions, warn: Callable[[str], None]) -> dict[str, Publisher]:
    out: dict[str, Publisher] = {}
    for name in how.topics or info.topics:
        topic = info.topics[name]
        if how.clock and name == "/clock":
            continue
        try:
            kind: Any = message_class(topic.type)
        except UnknownTypeError as error:
            warn(f"{printable(name)} is not played: {error}")
            continue
        qos = publisher_qos(topic.qos, _LATCHED_DEPTH if is_latched(topic.qos) else _DEPTH)
        try:
            out[name] = node.create_publisher(kind, how.remap.get(name, name), qos)
        except (InvalidTopicNameException, RCLError) as error:
            warn(f"{printable(name)} is not played: {reason(error)}")
    if not out:
        raise BagError(f"{info.folder}: there is nothing to play")
    return out


def _check(info: BagInfo, how: PlaybackOptions) -> None:
    if not how.rate > 0.0:
        raise BagError(f"--rate must be positive, not {how.rate}")
    if not 0.0 <= how.start_offset <= (info.end - info.start) * 1e-9:
        raise BagError(f"--start-offset must be 0 to {(info.end - info.start) * 1e-9:.3f} s, not {how.start_offset}")
    missing = (set(how.topics) | set(how.remap)) - set(info.topics)
    if missing:
        raise BagError(f"{info.folder} has no topic {', '.join(sorted(missing))}; it has {', '.join(info.topics)}")
