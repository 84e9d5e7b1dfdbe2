"""Team files in YAML, shared by coordinator and robots, which describe a team that drives between stations.

Each robot fetches parcels from shelves, brings them to desks and returns home after the last one. All robots have the
same options: wait, or drive to a station and work there.
"""

from __future__ import annotations

import hashlib
import json
from enum import StrEnum
from functools import cached_property
from pathlib import Path as FilePath
from typing import Annotated, Literal

from ctrl_rl_core.geometry import Point, PositiveTime, TimeStep
from ctrl_rl_core.io import read_yaml, short_path, short_repr
from ctrl_rl_core.tasks import Part, Reward, Samples, TaskHeader
from pydantic import Field, PrivateAttr, Strict, model_validator

from ctrl_rl_core import CtrlRlError, task_names
from option_coordinator.errors import OptionError
from option_coordinator.options.options import Agent
from option_coordinator.protocol.protocol_types import LONGEST_NAME
from option_coordinator.protocol.team import RobotSpec

FOLDER = FilePath(__file__).parent
KIND = "team_delivery"
OBSERVED = ("x", "y", "carries", "deliveries")
"""Observation of a robot: position [m], whether it carries a parcel, and the number of parcels delivered."""


Skill = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME)]


class Work(StrEnum):
    """Work at the end of an option."""

    WAIT = "wait"
    FETCH = "fetch"
    DELIVER = "deliver"
    REST = "rest"


class NavigationOption(Part):
    """One option: its work, its time limit, and its position, if it has one.

    Attributes:
        work: Work at the end of the option; `wait` stands still, `rest` leads home.
        longest: Maximum duration of the option [s].
        station: Goal position [m]; None for `wait` and `rest`.
        lasts: Duration of the work [s].
    """

    work: Annotated[Work, Strict(False)]
    longest: PositiveTime
    station: Point | None = None
    lasts: PositiveTime = 1.0

    @model_validator(mode="after")
    def _leads_somewhere(self) -> NavigationOption:
        if (self.station is None) == (self.work in (Work.FETCH, Work.DELIVER)):
            raise ValueError("'fetch' and 'deliver' need a 'station', 'wait' and 'rest' have none")
        return self


class TeamRobot(Part):
    """One robot.

    Attributes:
        home: Home position [m].
        skills: What the robot can do that not every robot can: a task may need it.
    """

    home: Point
    # Left out where empty, so that the digest of a team without skills is that of before.
    skills: Annotated[tuple[Skill, ...], Strict(False)] = Field(
        default=(), max_length=100, exclude_if=lambda skills: not skills
    )


class TeamRewards(Part):
    """Rewards that each robot contributes to the team's."""

    step: Reward
    delivery: Reward


class Learning(Part):
    """Settings for learning a team policy.

    Attributes:
        episode: Maximum duration of an episode [s].
        training_samples: Number of low-level steps of training.
        batch_samples: Number of low-level steps between two updates.
    """

    episode: PositiveTime
    training_samples: Samples
    batch_samples: Samples


class TeamFile(TaskHeader):
    """A team and its task.

    Attributes:
        kind: Kind of task, always "team_delivery".
        time_step: Duration of a low-level step, the unit of option durations [s].
        discount: Discount factor gamma of a low-level step.
        deliveries: Number of deliveries per robot; 0 if work arrives, and a robot delivers as long as there is any.
        options: Options of every robot by name, in order.
        safe_option: Name of the option that a robot runs while no grant arrives.
        robots: Robots by name, which is also their topic namespace.
        rewards: Rewards of a low-level step and of a delivery.
        room: Navigation task used as the room: the name of one shipped with the package or the suite, or a .yaml file,
            relative to the team file's folder.
        learning: Settings for learning a policy.
    """

    kind: Literal["team_delivery"]
    time_step: TimeStep
    discount: float = Field(gt=0.0, le=1.0)
    deliveries: int = Field(ge=0, le=1000)
    options: dict[str, NavigationOption] = Field(min_length=1, max_length=1000)
    safe_option: str
    robots: dict[str, TeamRobot] = Field(min_length=1, max_length=1000)
    rewards: TeamRewards
    room: str
    learning: Learning
    _folder: FilePath = PrivateAttr(default=FOLDER)

    @model_validator(mode="after")
    def _safe(self) -> TeamFile:
        if self.safe_option not in self.options:
            raise ValueError(f"safe_option: {short_repr(self.safe_option)} is none of the options")
        lacking = [work.value for work in Work if work not in {option.work for option in self.options.values()}]
        if lacking:
            raise ValueError(f"options: none of them is to {', '.join(lacking)}: a team needs one for each work")
        return self

    def place(self, folder: FilePath) -> None:
        """Set the folder of the team's file, from which a relative room file counts."""
        self._folder = folder

    @property
    def room_file(self) -> str:
        """Name or path of the room, as accepted by `ctrl_rl_core.tasks.task.load_task`."""
        return room_file(self.room, self._folder)

    @property
    def option_names(self) -> tuple[str, ...]:
        """Names of every robot's options, in order."""
        return tuple(self.options)

    @property
    def training_samples(self) -> int:
        """Number of low-level steps of training."""
        return self.learning.training_samples

    @property
    def batch_samples(self) -> int:
        """Number of low-level steps between two updates."""
        return self.learning.batch_samples

    @cached_property
    def digest(self) -> str:
        """SHA-256 (hex) of robots, options and stations, in order: what coordinator and robots must agree on."""
        robots = [(name, robot.home) for name, robot in self.robots.items()]
        options = [(name, option.work.value, option.station) for name, option in self.options.items()]
        content = json.dumps((robots, options, self.deliveries))
        return hashlib.sha256(content.encode()).hexdigest()

    @cached_property
    def coordinated(self) -> tuple[RobotSpec, ...]:
        """Robots with their coordinator settings."""
        durations = tuple(option.longest for option in self.options.values())
        safe = self.option_names.index(self.safe_option)
        return tuple(RobotSpec(Agent(name, self.option_names, len(OBSERVED)), durations, safe) for name in self.robots)


def team_names() -> list[str]:
    """Return the names of the shipped teams."""
    return sorted(file.stem for file in FOLDER.glob("*_team.yaml"))


def team_file(name_or_path: str) -> FilePath:
    """Return the file of a shipped team, or the path unchanged.

    Raises:
        OptionError: The team does not exist.
    """
    path = FilePath(name_or_path).expanduser()
    if path.suffix in (".yaml", ".yml"):
        return path
    path = FOLDER / f"{name_or_path}.yaml"
    if name_or_path not in team_names():
        raise OptionError(
            f"no team '{short_path(name_or_path)}': there is {', '.join(team_names())}, or give a .yaml file"
        )
    return path


def room_names() -> list[str]:
    """Return the names of the shipped rooms."""
    return sorted(file.stem for file in FOLDER.glob("*_room.yaml"))


def room_file(name_or_path: str, folder: FilePath | None = None) -> str:
    """Return name or path of a room, as accepted by `ctrl_rl_core.tasks.task.load_task`.

    Args:
        name_or_path: Name of a room of the package or of a task of the suite, or a .yaml file.
        folder: Base folder of a relative path; the working directory if None.

    Raises:
        OptionError: The room does not exist.
    """
    path = FilePath(name_or_path).expanduser()
    if path.suffix in (".yaml", ".yml"):
        return str(path if folder is None else folder / path)
    if name_or_path in room_names():
        return str(FOLDER / f"{name_or_path}.yaml")
    if name_or_path not in task_names():
        known = ", ".join((*room_names(), *task_names()))
        raise OptionError(f"no room '{name_or_path}': there are {known}, or give a .yaml file")
    return name_or_path


def is_team(name_or_path: str) -> bool:
    """Return whether a name or file denotes a team."""
    path = FilePath(name_or_path).expanduser()
    if path.suffix not in (".yaml", ".yml"):
        return name_or_path in team_names()
    try:
        content = read_yaml(path)
    except (OSError, CtrlRlError):
        return False
    return isinstance(content, dict) and content.get("kind") == KIND
