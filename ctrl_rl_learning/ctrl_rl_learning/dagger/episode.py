"""Lessons: drives of pupil or teacher in the simulator, in which the teacher says at each scan what to do."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from ctrl_rl_core.policies.observation import ObservationBuilder
from numpy.typing import NDArray

from ctrl_rl_core import (
    CtrlRlError,
    DriveSafety,
    NavigationTask,
    ObstacleStop,
    Outcome,
    PolicyManifest,
    ScanHealth,
)
from ctrl_rl_learning.dagger.expert import Expert, limits_between_posts, wheeled
from sim_bridge import SimulatedWorld, SimulationOptions

Array = NDArray[np.float64]
Observation = NDArray[np.float32]
Student = Callable[[Observation], Array]
"""Function from an observation (n,) to a command (2,)."""

_BEARINGS = 180
_FARTHEST = 2.0
_RATE = 60
"""Physics steps per second [Hz]; the planar engine needs no more."""
_STANDS = 10.0
"""Time without motion after which a drive is over [s]."""
_STILL = 0.005
_REACTION = 0.3
"""Time from a scan to the effect of its command [s], as of nodes."""


def corridor_interface(task: NavigationTask) -> PolicyManifest:
    """Return the interface of a pupil: ranges all around and the robot's speeds, at each scan of any lidar."""
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
    """One scan of a lesson.

    Attributes:
        observation: Observation of the pupil (n,).
        wanted: Command of the teacher (2,) [m/s, rad/s].
    """

    observation: Observation
    wanted: Array


class DaggerEpisode:
    """One episode, in the planar engine with the conditions that the task draws.

    Attributes:
        outcome: Outcome of the episode; still running where the robot stood too long.
    """

    def __init__(self, task: NavigationTask, interface: PolicyManifest, seed: int) -> None:
        settings = SimulationOptions(engine="planar", rate=_RATE, randomise_width=True)
        self._world = SimulatedWorld(task, seed, options=settings)
        self._teacher = Expert(task, self._world.geometry)
        self._observe = ObservationBuilder(interface)
        robot = wheeled(task)
        stop = ObstacleStop(robot.through_gaps, 0.0, robot.plan.braking, _REACTION)  # what a node has in doorways
        self._safety = DriveSafety(ScanHealth(0.0, 6.3, 0), stop, robot.lidar.x, 1.0)
        self.outcome = Outcome.RUNNING

    def drive(self, pupil: Student | None) -> Iterator[LabelledSample]:
        """Yield the moments of a drive of the pupil, or of the teacher where there is none, to its end."""
        world, still = self._world, 0.0
        period = 1.0 / world.lidar.spec.rate
        steps = round(period * _RATE)
        try:
            while self.outcome is Outcome.RUNNING and still < _STANDS:
                moment, command = self._decide(pupil)
                yield moment
                world.command(0, command)
                world.step(steps)
                still = 0.0 if np.abs(world.velocity()).max() > _STILL else still + period
                self.outcome = world.episode().outcome
        finally:
            world.close()

    def _decide(self, pupil: Student | None) -> tuple[LabelledSample, Array]:
        world = self._world
        scan, reading = world.laser_scan(), world.odometry()
        stamp = round(1e9 * world.elapsed)
        v, _, omega = reading.velocity.tolist()
        none = np.zeros(2)
        seen = self._observe(world.sensors(scan=scan))
        moment = LabelledSample(seen, self._teacher.command(world.pose(), np.array((v, omega))))
        self._safety.update(world.elapsed, stamp, "base_scan", scan.ranges, scan.geometry, (v, omega))
        try:
            return moment, self._safety.limit(moment.wanted if pupil is None else pupil(seen), v, 0.0)[0]
        except CtrlRlError:
            return moment, none
