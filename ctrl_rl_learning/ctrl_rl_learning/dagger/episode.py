"""Simulated episodes that student or expert drives, with the expert's command as the label of each scan."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from ctrl_rl_core.policies import ObservationBuilder
from numpy.typing import NDArray

from ctrl_rl_core import (
    DriveSafety,
    NavigationTask,
    ObstacleStop,
    PolicyManifest,
    ScanHealth,
    Sensors,
    drive,
)
from ctrl_rl_learning.dagger.expert import Expert, limits_between_posts, wheeled
from sim_bridge import SimulatedRobot, SimulatedWorld, SimulationOptions

Array = NDArray[np.float64]
Observation = NDArray[np.float32]
Student = Callable[[Observation], Array]
"""Function from an observation (n,) to a command (2,)."""

_BEARINGS = 180
_FARTHEST = 2.0
_RATE = 60
"""Physics rate [Hz]; enough for the planar engine."""
_STANDS = 10.0
"""Time without motion that ends a drive [s]."""
_REACTION = 0.3
"""Time from a scan to the effect of its command [s], the same as for nodes."""


def corridor_interface(task: NavigationTask) -> PolicyManifest:
    """Return the student's interface: ranges all around and the robot's speeds, once per scan, for any lidar."""
    limits, step = limits_between_posts(wheeled(task)), 2.0 * math.pi / _BEARINGS
    scan = {"source": "scan", "count": _BEARINGS, "step": step, "half_width": 0.5 * step}
    speeds = {"source": "odometry", "names": ["v", "omega"], "low": [-1.0, -6.0], "high": [1.0, 6.0]}
    return PolicyManifest.model_validate(
        {
            "robot": "differential_drive",
            "observation": [
                {**scan, "low": task.lidar.range.low, "high": _FARTHEST, "middle": 0.6, "unit": 0.5},
                {**speeds, "unit": [limits.speed, limits.turn_rate]},
            ],
            "action": {"low": [0.0, -limits.turn_rate], "high": [limits.speed, limits.turn_rate]},
            "about": task.about,
        }
    )


class LabelledSample(NamedTuple):
    """One scan of an episode with its label.

    Attributes:
        observation: Observation of the student (n,).
        wanted: Command of the expert (2,) [m/s, rad/s].
    """

    observation: Observation
    wanted: Array


class DaggerEpisode(NamedTuple):
    """One episode that student or expert drove.

    Attributes:
        samples: Scans of the episode, each with the expert's command.
        outcome: Name of the outcome; RUNNING if the robot stood still too long.
    """

    samples: list[LabelledSample]
    outcome: str


class _Labeller:
    """Driver that follows the student, or the expert if there is none, and labels each scan by the expert."""

    def __init__(
        self, task: NavigationTask, interface: PolicyManifest, world: SimulatedWorld, student: Student | None
    ) -> None:
        self._world, self._student = world, student
        self._expert, self._observe = Expert(task, world.geometry), ObservationBuilder(interface)
        self.samples: list[LabelledSample] = []

    def command(self, sensors: Sensors) -> Array:
        seen = self._observe(sensors)
        wanted = self._expert.command(self._world.pose(), np.array(sensors.speeds))
        knows = bool(np.isfinite(wanted).all())
        if knows:
            self.samples.append(LabelledSample(seen, wanted))
        if self._student is not None:
            return self._student(seen)
        return wanted if knows else np.zeros(2)


def drive_labelled(
    task: NavigationTask,
    interface: PolicyManifest,
    seed: int,
    student: Student | None = None,
    width: float | None = None,
) -> DaggerEpisode:
    """Drive one episode in the planar engine under the task's random conditions.

    Args:
        task: Task of a robot on wheels.
        interface: Observation of the student.
        seed: Seed of the episode.
        student: Student that drives; the expert unless given.
        width: Free width of the corridor [m]; drawn as the task says unless given.
    """
    robot = wheeled(task)
    stop = ObstacleStop(robot.through_gaps, 0.0, robot.plan.braking, _REACTION)  # what a node has in doorways
    safety = DriveSafety(ScanHealth(0.0, 6.3, 0), stop, robot.lidar.x, 1.0)
    settings = SimulationOptions(engine="planar", rate=_RATE, randomise_width=width is None)
    world = SimulatedWorld(task, seed, width=width, options=settings)
    try:
        driver = _Labeller(task, interface, world, student)
        simulated = SimulatedRobot(world, 1.0 / world.lidar.spec.rate, patience=_STANDS)
        (episode,) = drive(simulated, driver, safety, seeds=(seed,))
    finally:
        world.close()
    return DaggerEpisode(driver.samples, episode.outcome)
