"""One drive of the benchmark and its score: the simulator, a driver, and an optional filter."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Driver, Filter, Outcome, Sensors, find_robot
from ctrl_rl_core import drive as drive_episodes
from ctrl_rl_trials.barn.scenarios import LIMIT, Scenario
from sim_bridge import SimulatedRobot, SimulatedWorld, SimulationOptions

FASTEST = 2.0
"""Speed of the optimal time [m/s]."""
LOW, LOW_ROS2, HIGH = 2.0, 4.0, 8.0


def score(succeeded: bool, seconds: float, length: float, low: float = LOW) -> float:
    """Return the score of one drive, 0 to 1 / low.

    Args:
        succeeded: Whether the robot reached the goal in time and without contact.
        seconds: Time from the first motion to the end [s].
        length: Length of the optimal path [m].
        low: Multiple of the optimal time below which a shorter time does not raise the score.
    """
    optimal = length / FASTEST
    return float(succeeded) * optimal / min(max(seconds, low * optimal), HIGH * optimal)


Array = NDArray[np.float64]

PERIOD = 0.05
"""Time between two commands [s]; each command has its own scan."""
LIDAR_X = find_robot("jackal").lidar.x
"""Distance of the lidar in front of the robot's centre [m]."""
_MOVED = 0.1
"""Distance from the start at which the clock starts [m]."""
_PATIENCE = 15.0
_AROUND = 0.5
"""Time [s] and distance [m]: a robot that stays this long within this distance of a point counts as timed out."""
_STANDS = 0.05
"""Speed below which a robot counts as standing [m/s]."""


End = Literal["goal", "collision", "hit", "time-out"]
"""End of a drive: goal, collision, hit by a moving obstacle while the robot stood, or time-out."""


@dataclass(frozen=True)
class BarnDrive:
    """Result of one drive.

    Attributes:
        world: Number of the world.
        end: How the drive ended.
        seconds: Time from the first motion to the end [s].
        length: Length of the optimal path [m].
        distance: Distance from the goal at the end [m].
    """

    world: int
    end: End
    seconds: float
    length: float
    distance: float

    def score(self, low: float = LOW) -> float:
        """Return the score, 0 to 1 / low, see the function `score`."""
        return score(self.end == "goal", self.seconds, self.length, low)


class BarnRobot:
    """Robot of a scenario with Gymnasium's interface; an episode is truncated if the robot is stuck or time is up.

    Attributes:
        trace: x, y, theta and the command of each period (5,).
    """

    def __init__(self, scenario: Scenario, world: SimulatedWorld) -> None:
        self.trace: list[Array] = []
        self._scenario, self._world, self._robot = scenario, world, SimulatedRobot(world, PERIOD)
        self._begun, self._last, self._last_at = math.nan, world.pose(), 0.0

    def reset(self, *, seed: int) -> tuple[Sensors, dict[str, Any]]:
        """Begin an episode with a seed."""
        out = self._robot.reset(seed=seed)
        self._begun, self._last, self._last_at = math.nan, self._world.pose(), 0.0
        return out

    def step(self, command: Array) -> tuple[Sensors, float, bool, bool, dict[str, Any]]:
        """Apply a command (2,) for one period."""
        self.trace.append(np.concatenate((self._world.pose(), command)))
        sensors, reward, terminated, truncated, info = self._robot.step(command)
        if not (terminated or truncated):
            now, place = self._world.elapsed, self._world.pose()
            if math.isnan(self._begun) and math.dist(place[:2], self._scenario.start[:2]) >= _MOVED:
                self._begun = now
            if math.dist(place[:2], self._last[:2]) >= _AROUND:
                self._last, self._last_at = place, now
            truncated = now - self._last_at >= _PATIENCE or now - self._begun >= LIMIT
        return sensors, reward, terminated, truncated, info

    def ended(self) -> BarnDrive:
        """Return the result of the drive."""
        scenario, world, episode = self._scenario, self._world, self._world.episode()
        running = episode.outcome is Outcome.RUNNING or math.isnan(self._begun)
        seconds = LIMIT if running else round(world.elapsed - self._begun, 3)
        end: End = "time-out"
        if episode.outcome is Outcome.COLLISION:
            end = "hit" if episode.contact is not None and episode.contact.speed < _STANDS else "collision"
        elif episode.outcome is Outcome.GOAL and seconds <= LIMIT:
            end = "goal"
        distance = math.dist(world.pose()[:2], scenario.goal)
        return BarnDrive(scenario.number, end, seconds, round(scenario.length, 3), round(distance, 3))


def drive(
    scenario: Scenario,
    driver: Driver[Sensors],
    check: Filter[Sensors] | None,
    seed: int,
    options: SimulationOptions,
    trace: list[Array] | None = None,
) -> BarnDrive:
    """Drive once by the rules of the challenge.

    Args:
        scenario: World to drive in.
        driver: Unused driver.
        check: Filter for the driver's commands, or None.
        seed: Seed of noise and drift.
        options: Settings of the simulation.
        trace: List that receives x, y, theta and the command of each period (5,).
    """
    world = SimulatedWorld(scenario.task, seed, options=options)
    try:
        robot = BarnRobot(scenario, world)
        drive_episodes(robot, driver, check, seeds=(seed,))
        if trace is not None:
            trace += robot.trace
        return robot.ended()
    finally:
        world.close()
