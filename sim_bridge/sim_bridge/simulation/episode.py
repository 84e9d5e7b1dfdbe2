"""Ground truth about one robot's episode: outcome, clearance and progress."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from ctrl_rl_core.tasks import PATH_NAMES, PathCoordinates, RewardSpec
from numpy.typing import NDArray

from ctrl_rl_core import ArcPath, NavigationTask, Outcome, System, terminal_reward

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Contact:
    """The contact that ended an episode.

    Attributes:
        speed: Maximum speed of any point of the robot just before contact [m/s]; about 0 for a stationary robot.
        mover: Index of the mover hit; None for a wall, an obstacle or another robot.
    """

    speed: float
    mover: int | None

    @property
    def words(self) -> str:
        """Description of the contact."""
        met = "" if self.mover is None else f"with mover {self.mover} "
        return f"{met}at {self.speed:.2f} m/s"


@dataclass
class EpisodeState:
    """Outcome, clearance and progress of one robot.

    Attributes:
        outcome: Outcome, set by the first terminal event.
        tilted: Whether the collision is a tilt beyond the task's limit.
        contact: Contact that ended the episode, or None.
        clearance: Last measured distance to a wall, obstacle, mover or robot [m].
        smallest_clearance: Minimum clearance of the episode [m].
        progress: Fraction of the path from start to goal; NaN without a path.
    """

    outcome: Outcome = Outcome.RUNNING
    tilted: bool = False
    contact: Contact | None = None
    clearance: float = math.inf
    smallest_clearance: float = math.inf
    progress: float = math.nan

    def record_clearance(self, clearance: float) -> None:
        """Record a measured clearance [m]; touching is a collision."""
        self.clearance = clearance
        self.smallest_clearance = min(self.smallest_clearance, clearance)
        if clearance <= 0.0:
            self.end(Outcome.COLLISION)

    def end(self, outcome: Outcome, tilted: bool = False) -> None:
        """Set the outcome unless it is already set."""
        if self.outcome is Outcome.RUNNING:
            self.outcome, self.tilted = outcome, tilted

    def reward(self, rewards: RewardSpec) -> float:
        """Return the task's reward for the current outcome (thesis Eq. 3.9, 3.15, 3.17)."""
        return float(terminal_reward(self.outcome, rewards, self.tilted, running=rewards.intermediate))


class TerminationChecker:
    """Decides the outcome of an episode from the task's goal, trap, tilt limit and time limit."""

    def __init__(self, task: NavigationTask, system: System, path: ArcPath | None) -> None:
        names = system.state_names if path is None else PATH_NAMES
        self._in_goal = task.goal.region.make_test(names)
        self._in_trap = None if task.trap is None else task.trap.region.make_test(names)
        self._tilt_limit = math.inf if task.robot.tilt_limit is None else task.robot.tilt_limit
        self._time_limit = task.episode.steps * task.episode.time_step
        self._path = None if path is None else PathCoordinates(path)
        self._goal_s = task.goal.intervals["s"].low if path is not None and "s" in task.goal.intervals else math.inf

    def start_s(self, pose: Array) -> float:
        """Return the arc length of a pose x, y, theta (3,) along the path [m]; NaN without a path."""
        return math.nan if self._path is None else float(self._path(pose)[0])

    def check(self, episode: EpisodeState, state: Array, pose: Array, elapsed: float, start_s: float) -> None:
        """Update the state of an episode.

        Args:
            episode: State of the episode, changed in place.
            state: State in the system's order (n,).
            pose: Pose x, y, theta or x, z, psi (3,) [m, m, rad].
            elapsed: Simulation time since the start [s].
            start_s: Arc length at the robot's start [m].
        """
        if self._path is not None:
            state = self._path(pose)
            way = self._goal_s - start_s
            episode.progress = min(max((state[0] - start_s) / way, 0.0), 1.0) if 0.0 < way < math.inf else math.nan
        if abs(pose[2]) > self._tilt_limit:
            episode.end(Outcome.COLLISION, tilted=True)
        elif self._in_goal(place := state.tolist()):
            episode.end(Outcome.GOAL)
        elif self._in_trap is not None and self._in_trap(place):
            episode.end(Outcome.TRAP)
        elif elapsed >= self._time_limit - 1e-9:
            episode.end(Outcome.TIMEOUT)
