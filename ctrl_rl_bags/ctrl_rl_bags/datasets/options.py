"""Options of all commands that read drives from bags, and topic selection."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, get_args

from ctrl_rl_core.command import at_least, one_of

from ctrl_rl_bags.alignment.clocks import Clock, Tell, warn
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
    """Selects the data to extract from bags.

    Attributes:
        robot: Namespace of the topics; may be empty.
        scan: Topic of the scans, relative to the robot's namespace unless it starts with /, as for the other topics.
        odometry: Topic of the odometry.
        commands: Topic of the commands; if empty, `cmd_vel` or else `rotor_thrusts`.
        image: Topic of the camera.
        task: Name of the task; if empty, from the bag's parameters.
        beams: Number of beams to which scans are resampled; None for that of the first scan.
        clock: `header` for message stamps; `log` for reception times, on the clock of the scans.
        period: Step length [s]; None for one step per scan.
        even: Whether to split a drive at steps of another length.
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
    """Topics of a drive by role, and the command type."""

    topics: dict[str, str]
    command: str
    command_topic: str


def find_topics(bag: Bag, options: ExtractionOptions) -> Wiring:
    """Find a drive's topics in a bag.

    Raises:
        BagError: Scans, odometry or commands are missing.
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
    """Describe a missing topic, its type, and the option that selects another one."""
    others = [printable(name) for name, each in sorted(bag.topics.items()) if each.type in kinds]
    return f"{topic} ({', '.join(kinds)}{f': {option} {others[0]}' if others else ''})"


def find_task(bag: Bag) -> str:
    """Return the task given by a recorded node's parameter."""
    for key, text in sorted(bag.info.custom_data.items()):
        if key.startswith("parameters."):
            with suppress(ValueError, AttributeError):
                task = json.loads(text).get("task")
                if isinstance(task, str) and task:
                    return Path(task).stem
    return "drive"


TASK_DIGEST = "digest.task"
"""Key of the task digest in a bag's custom data."""
_SHOWN = 12


@dataclass(frozen=True, kw_only=True)
class DriveOptions:
    """Selects topics, beams and clock of bags."""

    robot: str = ""
    """Namespace of the topics in the bags; none by default."""
    scan: str = "scan"
    """Topic of the scans, in the namespace unless it starts with /."""
    odometry: str = "odom"
    """Topic of the odometry."""
    commands: str = ""
    """Topic of the commands; by default cmd_vel, or else rotor_thrusts."""
    beams: at_least(1) | None = None  # type: ignore[valid-type]
    """Number of beams to resample all scans to; by default that of the first scan."""
    clock: Annotated[Clock, one_of(get_args(Clock))] = "header"
    """Time of messages: header for their stamps, log for reception times."""

    def extraction(self, **more: Any) -> ExtractionOptions:
        """Return the options for `extract`, including those in `more`."""
        return ExtractionOptions(
            robot=self.robot,
            scan=self.scan,
            odometry=self.odometry,
            commands=self.commands,
            beams=self.beams,
            clock=self.clock,
            **more,
        )


@dataclass(frozen=True, kw_only=True)
class TaskDriveOptions(DriveOptions):
    """Options for drives of one task."""

    other_task: bool = False
    """Also accept bags of another task, or of another version of it."""

    def as_words(self) -> str:
        """Return the given options of the bags, each after a space, for a command that reads the same bags."""
        given = {each.name: getattr(self, each.name) for each in fields(TaskDriveOptions)}
        changed = {each.name for each in fields(TaskDriveOptions) if given[each.name] != each.default}
        return "".join(
            f" --{name.replace('_', '-')}" + ("" if value is True else f" {shlex.quote(str(value))}")
            for name, value in given.items()
            if name in changed
        )


def check_task(
    bag: Path | str, custom_data: Mapping[str, str], task: str, digest: str, *, allowed: bool, tell: Tell = warn
) -> None:
    """Raise if a bag was recorded in another task; accept a bag that names no task.

    Args:
        bag: Bag to check.
        custom_data: Custom data of the bag.
        task: Name of the task to learn.
        digest: Digest of that task.
        allowed: Whether to report the difference instead of raising.
        tell: Called with the report; a Python warning by default.

    Raises:
        BagError: The digests differ.
    """
    there = custom_data.get(TASK_DIGEST, "")
    if not there or there == digest:
        return
    line = (
        f"{bag}: was recorded in another task than '{task}', or in another version of it "
        f"({TASK_DIGEST} {there[:_SHOWN]}, not {digest[:_SHOWN]})"
    )
    if not allowed:
        raise BagError(f"{line}: name that task, or take the bag with --other-task")
    tell(line)


def print_note(command: str, line: str) -> None:
    """Print a command's note to stderr."""
    sys.stderr.write(f"{command}: {line}\n")
