"""Which topics of a bag hold scans, odometry, commands and what else a drive has."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ctrl_rl_bags.alignment.clocks import Clock
from ctrl_rl_bags.datasets.frames import COMMAND_TYPES
from ctrl_rl_bags.format.checks import BagError, printable
from ctrl_rl_bags.format.reader import Bag

_TYPES = {
    "scan": "sensor_msgs/msg/LaserScan",
    "odom": "nav_msgs/msg/Odometry",
    "goal_pose": "geometry_msgs/msg/PoseStamped",
    "reward": "ctrl_rl_msgs/msg/TaskReward",
    "episode": "ctrl_rl_msgs/msg/EpisodeStatus",
    "image": "sensor_msgs/msg/Image",
}

_OPTIONS = {"scan": "--scan", "odom": "--odometry"}
_COMMANDS = ("cmd_vel", "rotor_thrusts")


@dataclass(frozen=True)
class ExtractionOptions:
    """What is taken from bags.

    Attributes:
        robot: Namespace of the topics; none where it is empty.
        scan: Topic of the scans, below the robot's namespace; absolute with a / in front, as the others.
        odometry: Topic of the odometry.
        commands: Topic of the commands; `cmd_vel`, or else `rotor_thrusts`, where it is empty.
        image: Topic of the camera.
        task: Name of the task; empty for what the bag's parameters say.
        beams: Number of beams that scans are brought to; None for that of the first scan.
        clock: `header` for the messages' stamps; `log` for the times of reception, on the clock of the scans.
        period: Length of a step [s]; None for a step from each scan to the next.
        even: Whether steps that are not as long as the others part a drive.
    """

    robot: str = ""
    scan: str = "scan"
    odometry: str = "odom"
    commands: str = ""
    image: str = "camera/image_raw"
    task: str = ""
    beams: int | None = None
    clock: Clock = "header"
    period: float | None = None
    even: bool = False

    def topic(self, name: str) -> str:
        """Return the full name of a topic."""
        given = {"image": self.image, "scan": self.scan, "odom": self.odometry}.get(name, name)
        if given.startswith("/"):
            return given
        return f"/{self.robot.strip('/')}/{given}" if self.robot else f"/{given}"


@dataclass(frozen=True)
class Wiring:
    """Topics of a bag by what they are, and the type of its commands."""

    topics: dict[str, str]
    command: str
    command_topic: str


def find_topics(bag: Bag, options: ExtractionOptions) -> Wiring:
    """Return which topics of a bag hold what.

    Raises:
        BagError: There are no scans, odometry or commands.
    """
    topics = {name: options.topic(name) for name in _TYPES}
    there = {
        name: topic for name, topic in topics.items() if topic in bag.topics and bag.topics[topic].type == _TYPES[name]
    }
    commands = [options.topic(name) for name in ((options.commands,) if options.commands else _COMMANDS)]
    command = next((it for it in commands if it in bag.topics and bag.topics[it].type in COMMAND_TYPES), None)
    missing = [_missing(bag, topics[name], _OPTIONS[name], _TYPES[name]) for name in _OPTIONS if name not in there]
    missing += [] if command else [_missing(bag, " or ".join(commands), "--commands", *COMMAND_TYPES)]
    if missing:
        known = printable(", ".join(sorted(bag.topics)))
        raise BagError(f"{bag.path}: no topic {', '.join(missing)}; it has {known or 'none'}")
    assert command is not None
    return Wiring({**there, "command": command}, bag.topics[command].type, command)


def _missing(bag: Bag, topic: str, option: str, *kinds: str) -> str:
    """Return a topic that is missing, and the topics that may be named in its place."""
    others = [printable(name) for name, each in sorted(bag.topics.items()) if each.type in kinds]
    return f"{topic} ({', '.join(kinds)}{f': {option} {others[0]}' if others else ''})"


def find_task(bag: Bag) -> str:
    """Return the task that a node of the recording had as a parameter."""
    for key, text in sorted(bag.info.custom_data.items()):
        if key.startswith("parameters."):
            with suppress(ValueError, AttributeError):
                task = json.loads(text).get("task")
                if isinstance(task, str) and task:
                    return Path(task).stem
    return "drive"
