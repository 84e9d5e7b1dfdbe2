"""Drives episodes in a simulated world as a node would, and records them as a recorder would, without a ROS graph.

A policy gets the same sensors as in the node `policy`; the bag has scan, odom, goal_pose, cmd_vel and episode.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from ctrl_rl_bags.datasets import DriveWriter, EpisodeFrames, Frames, Layout, ScanLayout, Step, no_goal
from ctrl_rl_core.sensing import planar
from numpy.typing import NDArray

from ctrl_rl_core import Episode, NavigationTask, Outcome, Sensors, task_digest, terminal_reward
from ctrl_rl_core import Step as DriveStep
from ctrl_rl_core import drive as drive_episodes
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.driving.drivers import RandomDriver
from ctrl_rl_learning.sb3.environment import usual_rate
from sim_bridge import SimulatedRobot, SimulatedWorld, SimulationOptions

Array = NDArray[np.float64]
_BEGIN_NS = 10**9
_PAUSE_NS = 5 * 10**9


class Drives(NamedTuple):
    """How episodes ended.

    Attributes:
        outcomes: Values of `Outcome` (episodes,).
        steps: Number of commands (episodes,).
        rewards: Reward of the task at the end of each episode (episodes,).
    """

    outcomes: NDArray[np.int64]
    steps: NDArray[np.int64]
    rewards: Array

    @property
    def success(self) -> Array:
        """Whether each episode reached the goal, as 0 or 1 (episodes,)."""
        return (self.outcomes == int(Outcome.GOAL)).astype(np.float64)

    def returns(self, discount: float) -> Array:
        """Return the discounted return of each episode (episodes,)."""
        return np.asarray(self.rewards * discount ** (self.steps - 1))


def drive(
    task: NavigationTask,
    driver: RandomDriver,
    episodes: int,
    seed: int,
    bag: Path | None = None,
    engine: str = "planar",
    tell: Callable[[int], object] = lambda _: None,
) -> Drives:
    """Drive episodes, recorded where a bag is named.

    Args:
        task: Task of a robot on wheels.
        driver: Driver of the robot.
        episodes: Number of episodes.
        seed: Seed of the first episode; the others follow.
        bag: Folder of the bag, which must not exist; None to record nothing.
        engine: Physics engine, one of `sim_bridge.ENGINES`.
        tell: Told the number of episodes since the last call.

    Raises:
        LearningError: The robot has no wheels.
        BagError: The bag exists, or the disk refuses.
    """
    if task.plane != "xy":
        raise LearningError(f"task '{task.name}' is a quadrotor's: only robots on wheels are driven here")
    options = SimulationOptions(engine=engine, rate=usual_rate(task, engine))
    world, layout, disc = SimulatedWorld(task, options=options), layout_of(task), task.goal.region.disc
    place = no_goal() if disc is None else np.array((*disc.centre, 0.0, 0.0, 0.0, 0.0, 1.0))
    robot = SimulatedRobot(world, task.episode.time_step, None if disc is None else planar(place.tolist()))
    found: list[Episode[Sensors]] = []
    writer = None if bag is None else DriveWriter(bag, layout)
    try:
        time = _BEGIN_NS
        for number in range(episodes):
            driver.begin(np.random.default_rng((seed + number, 1)))
            recording = _Recording(layout, place, time)
            found += drive_episodes(robot, driver, seeds=(seed + number,), watch=recording.note)
            time += round(found[-1].steps * task.episode.time_step * 1e9) + _PAUSE_NS
            if writer is not None:
                for frames in recording.end():
                    writer.write(replace(frames, episode=number))
            tell(1)
    finally:
        world.close()
        if writer is not None:
            writer.close()
    outcomes = np.array([Outcome[each.outcome] for each in found], dtype=np.int64)
    steps = np.array([each.steps for each in found], dtype=np.int64)
    return Drives(outcomes, steps, np.asarray(terminal_reward(outcomes, task.rewards)))


class _Recording:
    """The messages of one episode, from a time on [ns]."""

    def __init__(self, layout: Layout, goal: Array, time: int) -> None:
        self._frames, self._goal, self._time = EpisodeFrames(layout), goal, time
        self._step = round((layout.period or 0.0) * 1e9)
        self._pieces: list[Frames] = []

    def note(self, step: DriveStep[Sensors]) -> None:
        """Take a state of the episode."""
        sensors, outcome = step.sensors, int(Outcome[step.info["outcome"]])
        row = Step(
            self._time, self._time, sensors.ranges, sensors.odometry, self._goal, None, step.command, np.nan, outcome
        )
        self._pieces += self._frames.add(row)
        self._time += self._step

    def end(self) -> list[Frames]:
        """Return the messages."""
        return [*self._pieces, *self._frames.end()]


def layout_of(task: NavigationTask) -> Layout:
    """Return the layout of a task's bags."""
    lidar = task.lidar
    narrow = [
        float(np.float32(it)) for it in (lidar.angle_min, lidar.angle_increment, lidar.range.low, lidar.range.high)
    ]
    return Layout(
        command="geometry_msgs/msg/TwistStamped",
        command_topic="/cmd_vel",
        scan=ScanLayout(
            beams=lidar.beams,
            angle_min=narrow[0],
            angle_increment=narrow[1],
            range_min=narrow[2],
            range_max=narrow[3],
            frame="base_scan",
        ),
        goal=task.goal.region.disc is not None,
        task=task.name,
        period=task.episode.time_step,
        digests={"digest.task": task_digest(task)},
    )
