"""Report on a recorded drive: its outcome, clearance and control latency."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.ros import seconds
from numpy.typing import NDArray

from ctrl_rl_bags import BagError, bag_info, read_messages
from ctrl_rl_bringup.corridor.latent_model import LatentModel, read_latent_model
from ctrl_rl_bringup.corridor.surroundings import (
    FILTER,
    GUARD,
    MOVERS,
    FilterRecord,
    MoverTrack,
    read_filter,
    read_movers,
)
from ctrl_rl_bringup.runner.monitor import OUTCOMES
from ctrl_rl_bringup.runner.transport import (
    answer_latencies,
    late_answers,
    lost_messages,
    read_sent,
    recorded_parameters,
)
from ctrl_rl_core import load_navigation_task
from ctrl_rl_msgs.msg import TaskOutcome

Array = NDArray[np.float64]
_START_S = 0.5
"""Time until the first value of a run must arrive [s]."""
_FEWEST = 10
"""Messages of an episode by which its speed is measured."""
_ANSWERED = 0.9
"""Fraction of odometry messages that values must answer."""
_DIGEST = "digest."


@dataclass(frozen=True)
class DriveReport:
    """One drive as recorded; times are seconds of simulation since the start.

    Attributes:
        task: Name or file of the task.
        width: Width of the corridor [m], None for the task's own.
        outcome: Outcome, a constant of TaskOutcome.
        duration: Time until the outcome [s].
        collisions: Number of episodes that ended in a collision.
        smallest_clearance: Minimum distance from the body to a wall or obstacle [m].
        truth: True time, x, y (of a quadrotor x, z) in the frame map (n, 3) [s, m, m].
        odometry: The same by the robot's odometry, in the frame odom (n, 3) [s, m, m].
        clearance: Time and clearance (n, 2) [s, m].
        commands: Time, speed, turn rate (n, 3) [s, m/s, rad/s]; of a quadrotor time, T_1, T_2 [s, N, N].
        rewards: Time, reward, time to reach (n, 3) [s, 1, s]; no rows if none was recorded.
        oc_values: Time, optimal control value (n, 2) [s, 1]; no rows if none was recorded.
        latencies: Time from publishing a scan to publishing the command that answers it [s].
        messages: Number of recorded messages.
        lost: Number of messages published while the recorder listened, but not recorded.
        predictions: Time, one-step error of the latent model, and error of predicting no change (n, 3).
        speed: Simulation time per wall time that was achieved; NaN if unknown.
        late: Number of commands that came after the scan that follows the one that they answer.
        latent: Latent model of the controller; None if another driver drove.
        movers: Moving obstacles of the task.
        safety_filter: Answers of the safety filter or flight guard; None if neither ran.
        promised: Kinds of files that the run was started with, such as "policy", "time_to_reach" or "oc_value".
    """

    task: str
    width: float | None
    outcome: int
    duration: float
    collisions: int
    smallest_clearance: float
    truth: Array
    odometry: Array
    clearance: Array
    commands: Array
    rewards: Array
    oc_values: Array
    latencies: Array
    messages: int
    lost: int
    predictions: Array
    latent: LatentModel | None
    movers: tuple[MoverTrack, ...] = ()
    safety_filter: FilterRecord | None = None
    promised: frozenset[str] = frozenset()
    speed: float = float("nan")
    late: int = 0

    @property
    def reached(self) -> bool:
        """Whether the goal was reached."""
        return self.outcome == TaskOutcome.GOAL

    @property
    def time_to_reach(self) -> float:
        """Time to reach at the start [s]; NaN if no reward was recorded."""
        return float(self.rewards[0, 2]) if len(self.rewards) else float("nan")

    @property
    def left_grid(self) -> bool:
        """Whether the drive left the value's grid, for instance by its speed: it may then beat the time to reach."""
        return bool(len(self.rewards) and np.isnan(self.rewards[:, 2]).any())

    @property
    def lacks(self) -> list[str]:
        """Description of messages that the run's nodes should have published but the bag lacks; empty if complete."""
        out = []
        if "time_to_reach" in self.promised:
            out += self._gaps("reward", self.rewards)
        if "oc_value" in self.promised:
            out += self._gaps("optimal value", self.oc_values)
        if "policy" in self.promised and not len(self.latencies):
            out.append("no command answers a scan")
        return out

    def _gaps(self, name: str, values: Array) -> list[str]:
        """Describe what is missing of values that should answer each odometry message."""
        asked = self.odometry[:, 0]
        if not len(values):
            return [f"no {name}"]
        if len(asked) and values[0, 0] > asked[0] + _START_S:
            return [f"no {name} before {values[0, 0]:.1f} s"]
        if len(values) < _ANSWERED * len(asked):
            return [f"{len(values)} values of {name} for {len(asked)} of odometry"]
        return []

    def latency(self, percentile: float) -> float:
        """Return a percentile of the latencies [s]; NaN if no command answers a scan."""
        return float(np.percentile(self.latencies, percentile)) if len(self.latencies) else float("nan")

    def as_dict(self) -> dict[str, Any]:
        """Return the figures as plain JSON values."""
        return {
            "task": self.task,
            "outcome": OUTCOMES[self.outcome],
            "time_s": self.duration,
            "collisions": self.collisions,
            "smallest_clearance_m": self.smallest_clearance,
            "time_to_reach_at_start_s": self.time_to_reach if np.isfinite(self.time_to_reach) else None,
            "rewards": len(self.rewards),
            "oc_value_at_start": float(self.oc_values[0, 1]) if len(self.oc_values) else None,
            "latency_median_ms": 1e3 * self.latency(50),
            "latency_p99_ms": 1e3 * self.latency(99),
            "speed": self.speed if np.isfinite(self.speed) else None,
            "late_commands": self.late,
            "messages_recorded": self.messages,
            "messages_lost": self.lost,
            "latent_model": self.latent.as_dict() if self.latent else None,
            "safety_filter": self.safety_filter.as_dict() if self.safety_filter else None,
            "lacks": self.lacks,
        }

    def text(self) -> str:
        """Return the figures for people."""
        ms = [1e3 * self.latency(percentile) for percentile in (50, 99)]
        best = self.time_to_reach
        value = f"{self.oc_values[0, 1]:.0f} at the start" if len(self.oc_values) else "none"
        share = ""
        if np.isfinite(best) and self.left_grid:
            share = f"; the time to reach is {best:.1f} s at the speeds of its grid, which the drive left"
        elif np.isfinite(best):
            share = f", {self.duration / best:.2f} of the time to reach, {best:.1f} s"
        return "\n".join(
            (
                f"outcome             {OUTCOMES[self.outcome]}",
                f"time                {self.duration:.1f} s{share if self.reached else ''}",
                f"collisions          {self.collisions}",
                f"smallest clearance  {self.smallest_clearance:.3f} m",
                f"optimal value       {value}",
                f"control latency     {ms[0]:.2f} ms median, {ms[1]:.2f} ms p99, {len(self.latencies)} scans",
                f"speed               {self._speed_text()}",
                f"messages            {self.messages} recorded, {self.lost} lost",
                *(self.latent.text() if self.latent else ()),
                *(self.safety_filter.text() if self.safety_filter else ()),
            )
        )

    def _speed_text(self) -> str:
        """Return the speed of the simulation, and whether the drive depended on the computer's load."""
        said = f"{self.speed:.1f} times real time" if np.isfinite(self.speed) else "unknown"
        if not self.late:
            return f"{said}, each command before the next scan"
        return f"{said}; {self.late} commands came after the next scan: the drive depended on the computer's load"


def read_drive(bag: Path) -> DriveReport:
    """Read one robot's drive in one episode from a bag; of several namespaces the first by name.

    Raises:
        BagError: The bag cannot be read, or has no episode.
    """
    stamps: dict[str, list[float]] = defaultdict(list)
    rows: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    heard: list[int] = []
    info = bag_info(bag)
    flies = any(topic.endswith("/rotor_thrusts") for topic in info.topics)
    commands = "/rotor_thrusts" if flies else "/cmd_vel"
    topics = ("/scan", "/odom", "/ground_truth", commands, "/episode", "/reward", "/oc_value")
    spaces = [topic.removesuffix("/episode") for topic in info.topics if topic.endswith("/episode")]
    space = min(spaces, default="")
    recorded = [space + topic for topic in topics if space + topic in info.topics]
    if not spaces:
        raise BagError(f"{bag}: no topic /episode: is it a drive in the simulator?")
    for message in read_messages(bag, recorded):
        topic = message.topic.removeprefix(space)
        stamps[topic].append(_stamp(message.data))
        if topic == "/episode":
            heard.append(message.log_time)
        rows[topic].append(_row(topic, message.data, flies))
    if not rows["/episode"]:
        raise BagError(f"{bag}: no message on {space}/episode: the drive never began")
    begin = stamps["/episode"][0] - rows["/episode"][0][1]
    episode = np.array(rows["/episode"])
    task, width = _task_of(info.custom_data)

    def track(topic: str) -> Array:
        if topic not in rows:
            return np.empty((0, 3))
        return np.column_stack((np.array(stamps[topic]) - begin, np.array(rows[topic]).reshape(len(rows[topic]), -1)))

    sent = read_sent(bag)
    latent = read_latent_model(bag)
    guards = [topic for topic in (FILTER, GUARD) if topic in info.topics]
    return DriveReport(
        task=task,
        width=width,
        outcome=int(episode[-1, 3]),
        duration=_duration(episode),
        collisions=len({row[0] for row in episode if row[3] == TaskOutcome.COLLISION}),
        smallest_clearance=float(episode[:, 2].min()),
        truth=track("/ground_truth"),
        odometry=track("/odom"),
        clearance=np.column_stack((episode[:, 1], episode[:, 4])),
        commands=track(commands),
        rewards=track("/reward"),
        oc_values=track("/oc_value"),
        latencies=answer_latencies(sent.get(f"{space}/scan", ()), sent.get(space + commands, ())),
        messages=info.message_count,
        lost=lost_messages(sent),
        predictions=latent.steps - (begin, 0.0, 0.0) if latent else np.empty((0, 3)),
        latent=latent,
        movers=read_movers(bag, begin) if MOVERS in info.topics else (),
        safety_filter=read_filter(bag, begin, begin + _duration(episode), guards[0]) if guards else None,
        speed=_speed(episode, np.array(heard)),
        late=late_answers(sent.get(f"{space}/scan", ()), sent.get(space + commands, ())),
        promised=frozenset(key.removeprefix(_DIGEST) for key in info.custom_data if key.startswith(_DIGEST)),
    )


def _stamp(message: Any) -> float:
    header = getattr(message, "header", None)
    return float("nan") if header is None else seconds(header.stamp)


def _row(topic: str, message: Any, flies: bool) -> tuple[float, ...]:
    if topic == "/episode":
        return (
            message.episode,
            message.elapsed,
            message.smallest_clearance,
            message.outcome.value,
            message.clearance,
        )
    if topic in ("/odom", "/ground_truth"):
        position = message.pose.pose.position
        return position.x, position.z if flies else position.y
    if topic == "/rotor_thrusts":
        return message.t1, message.t2
    if topic == "/cmd_vel":
        twist = getattr(message, "twist", message)
        return twist.linear.x, twist.angular.z
    if topic == "/reward":
        return message.reward, message.time_to_reach
    if topic == "/oc_value":
        return (message.value,)
    return ()


def _duration(episode: Array) -> float:
    ended = episode[episode[:, 3] != TaskOutcome.RUNNING]
    return float(ended[0, 1] if len(ended) else episode[-1, 1])


def _speed(episode: Array, heard: NDArray[np.int64]) -> float:
    """Return the simulation time per wall time while the first episode ran; NaN if too little was heard of it."""
    ran = (episode[:, 0] == episode[0, 0]) & (episode[:, 3] == TaskOutcome.RUNNING)
    elapsed, wall = episode[ran, 1], 1e-9 * heard[ran]
    moving = elapsed > 0.0  # it is paused until all nodes are ready
    if moving.sum() < _FEWEST or not np.ptp(wall[moving]) > 0.0:
        return float("nan")
    return float(np.ptp(elapsed[moving]) / np.ptp(wall[moving]))


def _task_of(custom_data: Any) -> tuple[str, float | None]:
    """Return task and corridor width of the simulator, from its parameters."""
    parameters = recorded_parameters(custom_data, "sim_bridge")
    task, width = str(parameters.get("task", "curved_corridor")), parameters.get("corridor_width", 0.0)
    known = float(width) if isinstance(width, int | float) else 0.0
    return load_navigation_task(task).name if not task.endswith(".yaml") else task, known or None
