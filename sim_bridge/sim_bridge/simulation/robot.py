"""The robot of a simulated world for `ctrl_rl_core.driving.drive`: provides `Sensors` and takes commands.

robot = SimulatedRobot(SimulatedWorld(task), period=0.2)
episodes = drive(robot, PolicyDriver(policy), seeds=range(100))
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Outcome, Sensors
from sim_bridge.simulation.lidar import LidarScan
from sim_bridge.simulation.world import SimulatedWorld

Array = NDArray[np.float64]

_NO_SCAN = LidarScan(np.empty(0, np.float32), 0.0, 1.0, 0.0, 1.0)
_STILL = 0.005
"""Speed [m/s] and turn rate [rad/s] below which a robot counts as stationary."""


class RobotSenses:
    """Sensors of a world's first robot, including the last scan.

    Args:
        world: World of the robot.
        goal: Goal x, y, theta (3,) [m, m, rad], or None.
    """

    def __init__(self, world: SimulatedWorld, goal: Array | None = None) -> None:
        self._world, self._goal = world, goal
        self._scan, self._scanned_at = _NO_SCAN, -math.inf

    def __call__(self, command: Array, look: bool = True, pose: Array | None = None) -> Sensors:
        """Return the current sensor readings.

        Args:
            command: Last command (2,).
            look: Whether to take a new scan with new noise; otherwise the last one is reused.
            pose: Pose x, y, theta (3,) in the goal's frame; the odometry pose by default.
        """
        world = self._world
        if look:
            self._scan, self._scanned_at = world.laser_scan(), world.elapsed
        sensors = world.sensors(0, self._goal, command, self._scan)
        return sensors._replace(age=world.elapsed - self._scanned_at, pose=sensors.pose if pose is None else pose)


class SimulatedRobot:
    """The first robot of a world with Gymnasium's interface; each step holds a command and ends with a scan.

    Info has `outcome`, a name of `Outcome`; `smallest_clearance` [m]; the true `state` (n,); `seconds` since the start;
    and `stood`, the time for which the robot has been stationary [s].

    Args:
        world: World of the robot.
        period: Duration of a step [s].
        goal: Goal x, y, theta of the driver (3,) [m, m, rad], or None.
        patience: Stationary time after which the episode is truncated [s].
    """

    def __init__(
        self, world: SimulatedWorld, period: float, goal: Array | None = None, patience: float = math.inf
    ) -> None:
        self.world, self._goal, self._patience = world, goal, patience
        self._steps = max(1, round(period * world.options.rate))
        self._senses = RobotSenses(world, goal)
        self._stood = 0.0

    def reset(self, *, seed: int) -> tuple[Sensors, dict[str, Any]]:
        """Start the episode of a seed, unless the world is already at its start."""
        begin_episode(self.world, seed)
        self._stood, self._senses = 0.0, RobotSenses(self.world, self._goal)
        return self._senses(self.world.rest), self._info()

    def step(self, command: Array) -> tuple[Sensors, float, bool, bool, dict[str, Any]]:
        """Hold a command (2,) for one period."""
        world = self.world
        world.command(0, command)
        world.step(self._steps)
        moves = bool(np.abs(world.velocity()).max() > _STILL)
        self._stood = 0.0 if moves else self._stood + self._steps / world.options.rate
        episode = world.episode()
        cut = episode.outcome is Outcome.TIMEOUT or self._stood >= self._patience
        over = episode.outcome not in (Outcome.RUNNING, Outcome.TIMEOUT)
        return self._senses(command), episode.reward(world.task.rewards), over, cut and not over, self._info()

    def _info(self) -> dict[str, Any]:
        world = self.world
        episode = world.episode()
        return {
            "outcome": episode.outcome.name,
            "smallest_clearance": episode.smallest_clearance,
            "state": world.state(),
            "seconds": world.elapsed,
            "stood": self._stood,
        }


def begin_episode(world: SimulatedWorld, seed: int) -> None:
    """Start the episode of a seed in a world, unless the world is already at its start."""
    if world.seed != seed or world.steps:
        world.reset(seed)


def goal_of(task: NavigationTask) -> Array | None:
    """Return the centre of a task's goal as x, y, theta (3,) [m, m, rad]; theta is 0 if unconstrained.

    Returns None for a goal along a corridor, which has no fixed position.
    """
    region = task.goal.region
    if region.disc is None and not {"x", "y"} <= region.intervals.keys():
        return None
    place = region.disc.centre if region.disc is not None else [region.intervals[name].centre for name in ("x", "y")]
    heading = region.intervals["theta"].centre if "theta" in region.intervals else 0.0
    return np.array((*place, math.remainder(heading, 2.0 * math.pi)))
