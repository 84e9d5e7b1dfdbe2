"""A policy that drives in the simulator, in one process and without ROS's transport, as its node drives."""

from __future__ import annotations

from ctrl_rl_core.ros.parameters import of_robot

from ctrl_rl_bringup.runner.stack import through_doorways
from ctrl_rl_core import (
    LIDAR_PARAMETERS,
    DriveSafety,
    Episode,
    NavigationTask,
    ObstacleStop,
    Policy,
    PolicyDriver,
    ScanHealth,
    Sensors,
    drive,
)
from sim_bridge import SimulatedRobot, SimulatedWorld, SimulationOptions, goal_of

_DEFAULTS = {parameter.name: parameter.default for parameter in LIDAR_PARAMETERS}
_FASTEST = 1.0
_STANDS = 60.0


def play_episode(policy: Policy, task: NavigationTask, seed: int, options: SimulationOptions) -> Episode[Sensors]:
    """Drive one episode from its start to its end, or until the robot has stood still for a minute.

    Args:
        policy: Policy of the task's robot.
        task: Task to drive in; the middle of its goal is that of the policy, where it asks for one.
        seed: Seed of the episode.
        options: Settings of the simulation.
    """
    world = SimulatedWorld(task, seed, options=options)
    try:
        period = 1.0 / world.lidar.spec.rate if policy.period is None else policy.period
        robot = SimulatedRobot(world, period, goal_of(task) if "goal" in policy.needs else None, _STANDS)
        check = _make_safety(task) if policy.period is None else None
        (episode,) = drive(robot, PolicyDriver(policy), check, seeds=(seed,))
        return episode
    finally:
        world.close()


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
