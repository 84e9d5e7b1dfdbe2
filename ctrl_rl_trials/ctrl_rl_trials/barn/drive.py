"""One drive of the benchmark: the simulator, what the robot senses, a controller, and a filter below it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Outcome, ScanGeometry, find_robot
from ctrl_rl_trials.barn.scenarios import LIMIT, Scenario
from ctrl_rl_trials.barn.score import LOW, score
from sim_bridge import SimulatedWorld, SimulationOptions

Array = NDArray[np.float64]

PERIOD = 0.05
"""Time from command to command [s]; each has a scan of its own."""
LIDAR_X = find_robot("jackal").lidar.x
"""Position of the lidar ahead of the robot's middle [m]."""
_MOVED = 0.1
"""The clock starts when the robot is so far from its start [m]."""
_PATIENCE = 15.0
_AROUND = 0.5
"""A drive counts as timed out where the robot stays so long [s] within such a distance [m] of a place."""
_STANDS = 0.05
"""Speed below which a robot stands [m/s]."""


@dataclass(frozen=True)
class Sensed:
    """What the robot knows in one control period.

    Attributes:
        now: Time since the start [s].
        pose: Pose by odometry, in whose frame the goal is given (3,) [m, m, rad].
        motion: Speed and turn rate by odometry (2,) [m/s, rad/s].
        ranges: Ranges of the scan (beams,) [m].
        geometry: Bearings and limits of the scan.
        ends: Ends of the beams in the robot's frame (beams, 2) [m]; those without an echo end at the largest range.
        echoes: Which beams met something (beams,).
    """

    now: float
    pose: Array
    motion: Array
    ranges: NDArray[np.float32]
    geometry: ScanGeometry
    ends: Array
    echoes: NDArray[np.bool_]

    @property
    def points(self) -> Array:
        """Echoes in the robot's frame, in the order of their beams (n, 2) [m]."""
        return self.ends[self.echoes]


class Controller(Protocol):
    """Drives one robot to one goal."""

    def decide(self, sensed: Sensed) -> Array:
        """Return speed and turn rate to send (2,) [m/s, rad/s]."""

    def sent(self, command: Array) -> None:
        """Note what was sent in the end (2,)."""


Filter = Callable[[Sensed, Array], Array]
"""Returns the command to send in place of a raw one."""


End = Literal["goal", "collision", "hit", "time-out"]
"""End of a drive: the goal, a collision, a hit by something while the robot stood, or the end of the time."""


@dataclass(frozen=True)
class BarnDrive:
    """The end of one drive.

    Attributes:
        world: Number of the world.
        end: Kind of the end.
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
        """Return the score, 0 to 1 / low, as `score.score` has it."""
        return score(self.end == "goal", self.seconds, self.length, low)


def drive(
    scenario: Scenario,
    controller: Controller,
    check: Filter | None,
    seed: int,
    options: SimulationOptions,
    trace: list[Array] | None = None,
) -> BarnDrive:
    """Drive once, as the challenge does.

    Args:
        scenario: World to drive in.
        controller: Controller that has not driven yet.
        check: Filter below it; None for none.
        seed: Seed of noise and drift.
        options: Settings of the simulation.
        trace: Takes x, y, theta and the command of each period (5,).
    """
    world = SimulatedWorld(scenario.task, seed, options=options)
    try:
        steps, begin = round(PERIOD * world.options.rate), math.nan
        last, last_at = world.pose(), 0.0
        while world.episode().outcome is Outcome.RUNNING:
            place = world.pose()
            if math.isnan(begin) and math.dist(place[:2], scenario.start[:2]) >= _MOVED:
                begin = world.elapsed
            if math.dist(place[:2], last[:2]) >= _AROUND:
                last, last_at = place, world.elapsed
            if world.elapsed - last_at >= _PATIENCE or world.elapsed - begin >= LIMIT:
                break
            sensed = _sense(world)
            command = controller.decide(sensed)
            command = command if check is None else check(sensed, command)
            controller.sent(command)
            world.command(0, command)
            if trace is not None:
                trace.append(np.concatenate((place, command)))
            world.step(steps)
        return _ended(scenario, world, begin)
    finally:
        world.close()


def _ended(scenario: Scenario, world: SimulatedWorld, begin: float) -> BarnDrive:
    episode = world.episode()
    running = episode.outcome is Outcome.RUNNING or math.isnan(begin)
    seconds = LIMIT if running else round(world.elapsed - begin, 3)
    end: End = "time-out"
    if episode.outcome is Outcome.COLLISION:
        end = "hit" if episode.contact is not None and episode.contact.speed < _STANDS else "collision"
    elif episode.outcome is Outcome.GOAL and seconds <= LIMIT:
        end = "goal"
    distance = math.dist(world.pose()[:2], scenario.goal)
    return BarnDrive(scenario.number, end, seconds, round(scenario.length, 3), round(distance, 3))


def _sense(world: SimulatedWorld) -> Sensed:
    scan, reading = world.laser_scan(), world.odometry()
    bearings = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    ranges = np.nan_to_num(scan.ranges.astype(float), nan=0.0, posinf=scan.range_max, neginf=scan.range_min)
    ends = np.column_stack((LIDAR_X + ranges * np.cos(bearings), ranges * np.sin(bearings)))
    echoes = np.isfinite(scan.ranges) | np.isneginf(scan.ranges)
    motion = reading.velocity[[0, 2]]
    return Sensed(world.elapsed, reading.pose, motion, scan.ranges, scan.geometry, ends, echoes)
