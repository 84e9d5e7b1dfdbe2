"""Options of trials, and what becomes of one."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from ctrl_rl_core.command import FolderToWrite, NotNegative, OptionalFileToWrite, Positive
from ctrl_rl_core.robots import DEFAULT_ROBOT

from ctrl_rl_navigation.cli.goals import Trial
from ctrl_rl_navigation.cli.simulation import Drive
from ctrl_rl_navigation.driving.decision import NavigatorState
from ctrl_rl_navigation.maps import map_names


@dataclass(frozen=True)
class Options:
    """Drives a simulated robot to random goals on maps with the navigator, and counts what becomes of it.

    The pose has the errors of a localiser, and odometry drifts. Unreachable goals must be told as such.
    """

    maps: tuple[str, ...] = field(default_factory=map_names)
    """Names of maps, or NAME=FILE.yaml for others."""
    robot: str = DEFAULT_ROBOT
    """Name of a robot, or the path of its .yaml file."""
    goals: Positive = 100
    """Number of goals on each map."""
    seed: NotNegative = 0
    """Seed of starts, goals and errors."""
    engines: tuple[Literal["pybullet", "mujoco"], ...] = ("pybullet",)
    """Engines of the simulation, one after the other."""
    drift: float = 0.05
    """Standard deviation of odometry's relative errors."""
    position_error: float = 0.05
    """Standard deviation of each coordinate of the localiser's pose [m]."""
    heading_error: float = 3.0
    """Standard deviation of its heading [deg]."""
    folder: FolderToWrite = Path("runs/navigator")
    """Folder that keeps the drives of each map and engine: after an interruption trials go on where they were."""
    results: OptionalFileToWrite = None
    """JSON file for the results; rows of other maps and engines that it has are kept."""
    ros: bool = False
    """Drive through the real nodes instead of in one process."""


@dataclass(frozen=True)
class Outcome:
    """What became of one trial.

    Attributes:
        trial: Drive that was to be made.
        drive: End of the drive.
        best: Best time [s]; inf where no way leads to the goal.
        answered: Wall time until an unreachable goal was told as such [s]; NaN for others.
    """

    trial: Trial
    drive: Drive
    best: float
    answered: float

    @property
    def arrived(self) -> bool:
        """Whether the robot reached the goal and touched nothing."""
        return self.drive.state is NavigatorState.REACHED and not self.drive.collided
