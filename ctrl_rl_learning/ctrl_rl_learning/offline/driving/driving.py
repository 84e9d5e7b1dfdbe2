"""Drives episodes in a simulated world as a node would, and records them as a recorder would, without a ROS graph.

A policy gets the same sensors as in the node `policy`; the bag has scan, odom, goal_pose, cmd_vel and episode.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from ctrl_rl_bags.datasets.episodes import EpisodeFrames, Step
from ctrl_rl_bags.datasets.frames import Frames, Layout, ScanLayout
from ctrl_rl_bags.datasets.readings import no_goal
from ctrl_rl_bags.datasets.rebuilding import DriveWriter
from ctrl_rl_core.sensing.pose import planar
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Outcome, Sensors, make_odometry, task_digest, terminal_reward
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.driving.drivers import Driver
from ctrl_rl_learning.sb3.environment import usual_rate
from sim_bridge import SimulatedWorld, SimulationOptions

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
    driver: Driver,
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
    rate = usual_rate(task, engine)
    world = SimulatedWorld(task, options=SimulationOptions(engine=engine, rate=rate))
    found: list[tuple[int, int]] = []
    writer = None if bag is None else DriveWriter(bag, layout_of(task))
    try:
        time = _BEGIN_NS
        for number in range(episodes):
            world.reset(seed + number)
            driver.begin(np.random.default_rng((seed + number, 1)))
            pieces, outcome, steps = _episode(task, world, driver, rate, time)
            found.append((outcome, steps))
            time += round(steps * task.episode.time_step * 1e9) + _PAUSE_NS
            if writer is not None:
                for frames in pieces:
                    writer.write(replace(frames, episode=number))
            tell(1)
    finally:
        world.close()
        if writer is not None:
            writer.close()
    outcomes, steps_of = np.array(found, dtype=np.int64).T
    return Drives(outcomes, steps_of, np.asarray(terminal_reward(outcomes, task.rewards)))


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


def _episode(
    task: NavigationTask, world: SimulatedWorld, driver: Driver, rate: int, time: int
) -> tuple[list[Frames], int, int]:
    """Drive one episode; return its frames, its outcome and its number of commands."""
    layout = layout_of(task)
    scan, current, pieces = layout.scan, EpisodeFrames(layout), list[Frames]()
    step, counts = round(task.episode.time_step * 1e9), round(task.episode.time_step * rate)
    disc = task.goal.region.disc
    goal = no_goal() if disc is None else np.array((*disc.centre, 0.0, 0.0, 0.0, 0.0, 1.0))
    target = None if disc is None else planar(goal.tolist())
    command: Array | None = None
    outcome, steps = 0, 0
    while True:
        reading, ranges = world.odometry(0), world.scan(0)
        numbers = make_odometry(reading.pose, reading.velocity)
        now = time + steps * step
        pieces += current.add(Step(now, now, ranges, numbers, goal, None, command, np.nan, outcome))
        if outcome:
            return [*pieces, *current.end()], outcome, steps
        sensors = Sensors(
            ranges,
            scan.geometry,
            numbers,
            planar(numbers[:7].tolist()),
            target,
            np.zeros(2) if command is None else command,
        )
        command = np.asarray(driver.command(sensors), dtype=np.float64)
        world.command(0, command)
        world.step(counts)
        steps += 1
        outcome = int(world.episode(0).outcome)
