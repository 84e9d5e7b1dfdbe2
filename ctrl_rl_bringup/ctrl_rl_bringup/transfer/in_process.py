"""A policy that drives in the simulator, in one process and without ROS's transport, as its node drives."""

from __future__ import annotations

import math

import numpy as np
from ctrl_rl_core.ros.parameters import of_robot

from ctrl_rl_bringup.runner.stack import through_doorways
from ctrl_rl_core import (
    LIDAR_PARAMETERS,
    CtrlRlError,
    DriveSafety,
    NavigationTask,
    ObstacleStop,
    Outcome,
    Policy,
    ScanHealth,
)
from sim_bridge import EpisodeState, SimulatedWorld, SimulationOptions

_DEFAULTS = {parameter.name: parameter.default for parameter in LIDAR_PARAMETERS}
_FASTEST = 1.0
_STANDS = 60.0


def play_episode(policy: Policy, task: NavigationTask, seed: int, options: SimulationOptions) -> EpisodeState:
    """Drive one episode from its start to its end, or until the robot has stood still for a minute.

    Args:
        policy: Policy of the task's robot.
        task: Task to drive in; the middle of its goal is that of the policy, where it asks for one.
        seed: Seed of the episode.
        options: Settings of the simulation.
    """
    world = SimulatedWorld(task, seed, options=options)
    try:
        _Driver(policy, world).drive()
        return world.episode()
    finally:
        world.close()


class _Driver:
    """One policy in one world."""

    def __init__(self, policy: Policy, world: SimulatedWorld) -> None:
        self._policy, self._world = policy, world
        self._command, self._decided_at = policy.rest, -math.inf
        self._safety = _make_safety(world.task) if policy.period is None else None
        turns = 1.0 / world.lidar.spec.rate if policy.period is None else policy.period
        self._period = max(1, round(turns * world.options.rate))

    def drive(self) -> None:
        """Drive until the episode ends."""
        world, still = self._world, 0.0
        while world.episode().outcome is Outcome.RUNNING and still < _STANDS:
            world.command(0, self._decide())
            world.step(self._period)
            moves = bool(np.abs(world.velocity()).max() > 0.005)
            still = 0.0 if moves else still + self._period / world.options.rate

    def _decide(self) -> np.ndarray:
        """Return the next command (2,); that of a robot at rest where the policy or the checks give none."""
        world, policy = self._world, self._policy
        scan, reading = world.laser_scan(), world.odometry()
        forward, _, turn = reading.velocity.tolist()
        goal = _middle(world.task) if "goal" in policy.needs else None
        try:
            if self._safety is not None:
                now = world.elapsed
                self._safety.update(now, round(1e9 * now), "base_scan", scan.ranges, scan.geometry, (forward, turn))
                if self._safety.fault:
                    return policy.rest
            sensors = world.sensors(0, goal, self._command, scan)
            self._command = np.clip(policy.command(sensors), *policy.limits)
            if self._safety is not None:
                self._command, _ = self._safety.limit(self._command, forward, 0.0)
        except CtrlRlError:
            return policy.rest
        return self._command


def _make_safety(task: NavigationTask) -> DriveSafety:
    """Return the checks of a lidar's node with their defaults, or with those that leave room in doorways."""
    robot = task.robot.robot
    assert robot is not None, "a robot with a lidar on wheels"
    value = _DEFAULTS | {each.name: of_robot(robot, each.of_robot) for each in LIDAR_PARAMETERS if each.of_robot}
    value |= {} if task.doorways is None else through_doorways(task)
    health = ScanHealth(value["min_echo_share"], value["largest_gap"], value["frozen_scans"])
    obstacles = ObstacleStop(
        value["robot_radius"], value["obstacle_margin"], value["deceleration"], value["reaction_time"]
    )
    return DriveSafety(health, obstacles, value["lidar_x"], _FASTEST)


def _middle(task: NavigationTask) -> np.ndarray:
    """Return the middle of a task's goal as x, y, theta (3,)."""
    region = task.goal.region
    place = region.disc.centre if region.disc is not None else [region.intervals[name].centre for name in ("x", "y")]
    heading = region.intervals["theta"].centre if "theta" in region.intervals else 0.0
    return np.array((*place, heading))
