"""Options and outcome of trials."""

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
    """Drive a simulated robot to random goals on maps with the navigator, and count the outcomes.

    The pose has a localiser's errors, and odometry drifts. Unreachable goals must be reported as such.
    """

    maps: tuple[str, ...] = field(default_factory=map_names)
    """Names of maps, or NAME=FILE.yaml for others."""
    robot: str = DEFAULT_ROBOT
    """Name of a robot, or the path of its .yaml file."""
    goals: Positive = 100
    """Number of goals per map."""
    seed: NotNegative = 0
    """Random seed of starts, goals and errors."""
    engines: tuple[Literal["pybullet", "mujoco"], ...] = ("pybullet",)
    """Simulation engines, used one after the other."""
    drift: float = 0.05
    """Standard deviation of odometry's relative errors."""
    position_error: float = 0.05
    """Standard deviation of each coordinate of the localiser's pose [m]."""
    heading_error: float = 3.0
    """Standard deviation of the localiser's heading [deg]."""
    folder: FolderToWrite = Path("runs/navigator")
    """Folder for the drives of each map and engine, from which interrupted trials are resumed."""
    results: OptionalFileToWrite = None
    """JSON file for the results; existing rows of other maps and engines are kept."""
    ros: bool = False
    """Drive through the real nodes instead of in one process."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of one trial.

    Attributes:
        trial: The trial drive.
        drive: Result of the drive.
        best: Best time [s]; inf if no path leads to the goal.
        answered: Wall time until an unreachable goal was reported as such [s]; NaN for others.
    """

    trial: Trial
    drive: Drive
    best: float
    answered: float

    @property
    def arrived(self) -> bool:
        """Whether the robot reached the goal without contact."""
        return self.drive.state is NavigatorState.REACHED and not self.drive.collided
