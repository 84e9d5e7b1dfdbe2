"""Monitors drives: waits until the nodes are connected, starts the simulation, and shows progress."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import rclpy
from ctrl_rl_bags.recording import message_class
from rclpy.node import Node
from std_srvs.srv import SetBool
from tqdm import tqdm

from ctrl_rl_bringup.runner.processes import uninterrupted
from ctrl_rl_bringup.runner.stack import RAW, RAW_THRUSTS, DriveConfig
from ctrl_rl_core import RESULT, CtrlRlError
from ctrl_rl_msgs.msg import EpisodeStatus, TaskOutcome
from ctrl_rl_msgs.srv import ResetWorld, StepWorld

_LAYOUT = "{desc}: {percentage:3.0f}% of the way |{bar}| {postfix}"


class ProgressDisplay:
    """Shows one drive on standard error."""

    def __init__(self, title: str, lines: int) -> None:
        """Set it up.

        Args:
            title: Title of the display.
            lines: Number of lines to print if there is no terminal for a bar.
        """
        self._title = title
        self._lines = lines
        self._said = 0
        self._last = ""
        self._bar = tqdm(total=1.0, desc=title, bar_format=_LAYOUT) if sys.stderr.isatty() else None

    def show(self, progress: float, figures: str) -> None:
        """Show the fraction of the path done, 0 to 1 (NaN without a path), and a few words."""
        progress = min(1.0, max(0.0, progress)) if math.isfinite(progress) else 0.0
        if self._bar is not None:
            self._bar.set_postfix_str(figures, refresh=False)
            self._bar.update(max(0.0, progress - self._bar.n))
            return
        self._last = f"{self._title}: {100 * progress:3.0f}% of the way, {figures}\n"
        if int(self._lines * progress) > self._said:
            self._said = int(self._lines * progress)
            self._say()

    def close(self) -> None:
        """Show the final state and restore the terminal."""
        if self._bar is not None:
            self._bar.close()
        self._say()

    def _say(self) -> None:
        sys.stderr.write(self._last)
        sys.stderr.flush()
        self._last = ""


OUTCOMES = {
    TaskOutcome.RUNNING: "running",
    TaskOutcome.GOAL: "goal reached",
    TaskOutcome.COLLISION: "collision",
    TaskOutcome.TRAP: "trapped",
    TaskOutcome.TIMEOUT: "time-out",
}
RECORDER = "recorder"
_RECORDED = ("scan", "odom", "episode", "/clock", "ground_truth")
_SAID_EVERY_S = 10.0
_SILENT_S = 20.0
_STEP_S = 0.05
"""Longer than a period of odometry [s]."""
_ANSWER_S = 1.0


class MonitorError(CtrlRlError):
    """The nodes of a run did not start, or fell silent."""


@dataclass(frozen=True)
class EpisodeProgress:
    """State of an episode: number, outcome, time since the reset [s], fraction of the path, minimum clearance [m]."""

    number: int
    outcome: int
    elapsed: float
    progress: float
    smallest_clearance: float

    @property
    def figures(self) -> str:
        """Time and clearance, for people."""
        return f"{self.elapsed:5.1f} s, closest {self.smallest_clearance:.3f} m"


class Monitor:
    """A node that follows the episodes of one robot.

    Args:
        check: Called repeatedly; raises if a node of the run has died.
        topics: Further topics that must be recorded and must answer odometry before the drive begins.
        ready_limit: Time within which nodes must be ready and services must answer [s].
    """

    def __init__(
        self, check: Callable[[], None], topics: Sequence[str] = (), ready_limit: float = DriveConfig.ready_limit
    ) -> None:
        self._limit = ready_limit
        self._node = Node("monitor")
        self._topics = (*_RECORDED, "rotor_thrusts" if RAW_THRUSTS in topics else "cmd_vel", *topics)
        self._check = check
        self._episode: EpisodeProgress | None = None
        self._wanted = 0
        self._heard = time.monotonic()
        self._unheard = set(topics)
        self._node.create_subscription(EpisodeStatus, "episode", self._on_episode, RESULT)
        self._pause = self._node.create_client(SetBool, "sim_bridge/pause")
        self._step = self._node.create_client(StepWorld, "sim_bridge/step")
        self._reset = self._node.create_client(ResetWorld, "sim_bridge/reset")

    def close(self) -> None:
        """Remove the node from the graph."""
        self._node.destroy_node()

    @contextmanager
    def session(self) -> Iterator[None]:
        """Wait until everything is ready; at the end pause the world, to answer pending messages, and leave."""
        try:
            self.wait_until_ready()
            yield
            self.pause()
        finally:
            self.close()

    def wait_until_ready(self) -> None:
        """Wait until simulator, driver and recorder are connected and each awaited topic has had a message.

        Every ten seconds it logs what is missing: on a busy machine nodes may take minutes to start.

        Raises:
            MonitorError: The limit has passed, or a node of the run has died.
        """
        self._wait_for(self._missing)
        for topic in self._unheard:
            self._listen(topic)
        settle = time.monotonic() + 0.5  # the last match is seen here before it is seen by both of its ends
        while time.monotonic() < settle:
            self._spin()
        self._wait_for(self._unanswered)

    def run(self) -> None:
        """Resume the paused simulation."""
        self._call(self._pause, SetBool.Request(data=False))

    def pause(self) -> None:
        """Pause the simulation, so that pending messages are answered before the nodes end."""
        self._call(self._pause, SetBool.Request(data=True))

    def reset(self, seed: int) -> None:
        """Start a new episode."""
        self._wanted = self._call(self._reset, ResetWorld.Request(seed=seed)).episode
        self._episode = None

    def follow(self, title: str, lines: int = 10) -> EpisodeProgress:
        """Show the robot's progress until the episode has an outcome, and return how it ended.

        Args:
            title: Name of the drive in the display.
            lines: Number of lines to print if there is no terminal for a bar.

        Raises:
            MonitorError: The episode's messages stopped.
        """
        self._heard = time.monotonic()
        display = ProgressDisplay(title, lines)
        try:
            while self._episode is None or self._episode.outcome == TaskOutcome.RUNNING:
                self._spin()
                if time.monotonic() - self._heard > _SILENT_S:
                    raise MonitorError(f"no episode status for {_SILENT_S:g} s: does the simulator still run?")
                if self._episode is not None:
                    display.show(self._episode.progress, self._episode.figures)
        finally:
            display.close()
        return self._episode

    def _listen(self, topic: str) -> None:
        heard = partial(self._on_answer, topic)
        for info in self._node.get_publishers_info_by_topic(topic):
            self._node.create_subscription(message_class(info.topic_type), topic, heard, RESULT, raw=True)

    def _on_answer(self, topic: str, _message: bytes) -> None:
        self._unheard.discard(topic)

    def _unanswered(self) -> str:
        """Step the paused world, so that it sends odometry; return the awaited topics that do not answer."""
        if not self._unheard:
            return ""
        self._call(self._step, StepWorld.Request(duration=_STEP_S))
        patience = time.monotonic() + _ANSWER_S
        while self._unheard and time.monotonic() < patience:
            self._spin()
        return f"no message on {', '.join(sorted(self._unheard))}" if self._unheard else ""

    def _wait_for(self, missing: Callable[[], str]) -> None:
        """Wait until nothing is missing."""
        began = said = time.monotonic()
        while what := missing():
            self._spin()
            now = time.monotonic()
            if now > began + self._limit:
                raise MonitorError(f"not ready after {self._limit:g} s: {what}; --ready-limit waits longer")
            if now > said + _SAID_EVERY_S:
                said = now
                sys.stderr.write(f"waiting for {now - began:.0f} s: {what}\n")

    def _on_episode(self, message: EpisodeStatus) -> None:
        self._heard = time.monotonic()
        if message.episode != self._wanted:  # of the episode before the last reset, still under way
            return
        self._episode = EpisodeProgress(
            message.episode, message.outcome.value, message.elapsed, message.progress, message.smallest_clearance
        )

    def _missing(self) -> str:
        """Describe what is missing; empty if nothing is."""
        for topic in self._topics:
            subscribers = self._subscribers(topic)
            publishers = self._node.count_publishers(topic)
            if publishers == 0:
                return f"nobody publishes {topic}"
            if publishers > 1:
                raise MonitorError(f"{publishers} nodes publish {topic}: end the other run, or set ROS_DOMAIN_ID")
            if RECORDER not in subscribers:
                return f"the recorder does not hear {topic}"
            kind = topic.rsplit("/", 1)[-1]
            if kind in ("scan", "odom") and len(subscribers) < 2:
                return f"no driver hears {topic}"
            if kind in ("cmd_vel", "rotor_thrusts") and len(subscribers) < 2:
                return f"the simulator does not hear {topic}"
            if kind in (RAW, RAW_THRUSTS) and len(subscribers) < 2:
                return f"the watchdog does not hear {topic}"
        return (
            "" if self._pause.service_is_ready() and self._reset.service_is_ready() else "no pause and reset services"
        )

    def _subscribers(self, topic: str) -> set[str]:
        return {info.node_name for info in self._node.get_subscriptions_info_by_topic(topic)}

    def _call(self, client: rclpy.client.Client, request: object) -> Any:
        future = client.call_async(request)
        deadline = time.monotonic() + self._limit
        while not future.done():
            self._spin()
            if time.monotonic() > deadline:
                raise MonitorError(f"service {client.srv_name} does not answer")
        answer = future.result()
        if not answer.success:
            raise MonitorError(f"service {client.srv_name}: {answer.message}")
        return answer

    def _spin(self) -> None:
        self._check()
        with uninterrupted():  # rclpy makes a RuntimeError of an interruption while it converts a message
            rclpy.spin_once(self._node, timeout_sec=0.05)
