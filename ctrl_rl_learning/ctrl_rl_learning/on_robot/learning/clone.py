"""Clone a policy of any kind into a trainable network, by imitating it in the simulator.

The policy drives first, with some noise. Then the clone drives, and the policy labels each scan with its own command.
Ross, Gordon, Bagnell, "A reduction of imitation learning and structured prediction to no-regret online learning"
(AISTATS 2011).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from ctrl_rl_core.policies import ObservationBuilder
from numpy.typing import NDArray

from ctrl_rl_core import (
    Actor,
    CtrlRlError,
    NavigationTask,
    Outcome,
    Policy,
    PolicyManifest,
    Sensors,
    drive,
    task_digest,
)
from ctrl_rl_learning.dagger.student import Student
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.data.transitions import sensed_interface
from ctrl_rl_learning.offline.learners.learning import scales_of
from ctrl_rl_learning.sb3.environment import usual_rate
from sim_bridge import SimulatedRobot, SimulatedWorld, SimulationOptions, goal_of

Array = NDArray[np.float64]
Vectors = NDArray[np.float32]
ROUNDS, EPISODES = 4, 6
_UPDATES, _LAST_UPDATES = 400, 2000
_NOISE = 0.3
"""Noise of the first round, as a fraction of half the range of each command, so that the clone learns to recover."""
_PATIENCE = 5.0
"""Time without motion after which an episode is aborted [s]."""


class Clone(NamedTuple):
    """Network that imitates a policy.

    Attributes:
        actor: The network, as a policy.
        scans: Number of scans in its training data.
        error: Mean difference between the clone's and the policy's commands in the clone's own drives (2,)
            [m/s, rad/s].
        arrived: Number of the clone's last `EPISODES` drives that reached the goal.
    """

    actor: Actor
    scans: int
    error: Array
    arrived: int


class _Labeller:
    """Driver that follows a function of observation (n,) and the policy's command (2,), and stores both."""

    def __init__(self, policy: Policy, interface: PolicyManifest) -> None:
        self._policy, self._observe = policy, ObservationBuilder(interface)
        self.act: Callable[[Vectors, Array], Array] = lambda _seen, wanted: wanted
        self.seen: list[Vectors] = []
        self.wanted: list[Array] = []

    def drive_by(self, student: Student) -> None:
        """Make a student drive from now on."""
        self.act = lambda seen, _wanted: student.command(seen)

    def command(self, sensors: Sensors) -> Array:
        """Return the command (2,); a zero command if the policy gives none."""
        try:
            wanted = np.clip(self._policy.command(sensors), *self._policy.limits)
        except CtrlRlError:
            return self._policy.rest
        self.seen.append(self._observe(sensors))
        self.wanted.append(wanted)
        return np.clip(self.act(self.seen[-1], wanted), *self._policy.limits)


def clone(policy: Policy, task: NavigationTask, seed: int, tell: Callable[[int], object] = lambda _: None) -> Clone:
    """Return a network that imitates a policy in a task.

    Args:
        policy: Policy of any kind for a wheeled robot.
        task: Task to drive in the planar engine; a corridor's width is drawn at random.
        seed: Seed of starts, noise and network.
        tell: Progress callback; receives the number of new episodes, `ROUNDS` * `EPISODES` in total.

    Raises:
        LearningError: The policy is not for a wheeled robot, or gives no command in this task.
    """
    if policy.robot != "differential_drive":
        raise LearningError("only policies with commands v and omega learn on a robot")
    interface = _limited(sensed_interface(task), policy)
    half, random = 0.5 * (policy.limits[1] - policy.limits[0]), np.random.default_rng((seed, 2))
    labeller, error, arrived = _Labeller(policy, interface), np.full(2, np.nan), 0
    student: Student | None = None
    labeller.act = lambda _seen, wanted: wanted + _NOISE * half * random.normal(size=2)
    options = SimulationOptions(
        engine="planar", rate=usual_rate(task, "planar"), randomise_width=task.corridor is not None
    )
    world = SimulatedWorld(task, options=options)
    try:
        robot = SimulatedRobot(world, task.episode.time_step, goal_of(task), _PATIENCE)
        for number in range(ROUNDS):
            before, arrived = len(labeller.seen), 0
            for episode in range(EPISODES):
                (driven,) = drive(robot, labeller, seeds=(seed + number * EPISODES + episode,))
                arrived += driven.outcome == Outcome.GOAL.name
                tell(1)
            if not labeller.seen:
                raise LearningError(
                    f"the policy gives no command in task '{task.name}': was it trained on another task?"
                )
            seen, wanted = np.array(labeller.seen), np.array(labeller.wanted, np.float32)
            if student is None:
                torch.manual_seed(seed)
                student = Student(interface, *scales_of(seen))
                labeller.drive_by(student)
            else:
                own = np.array([student.command(each) for each in labeller.seen[before:]])
                error = np.abs(own - wanted[before:]).mean(axis=0)
            student.fit(seen, wanted, _UPDATES if number < ROUNDS - 1 else _LAST_UPDATES, random)
    finally:
        world.close()
    told = {"task": task.name, "task_digest": task_digest(task), "method": f"clone of {policy.description}"}
    assert student is not None
    return Clone(student.actor(told), len(labeller.seen), error, arrived)


def _limited(interface: PolicyManifest, policy: Policy) -> PolicyManifest:
    """Return the interface with the policy's own command limits and period."""
    low, high = (limit.tolist() for limit in policy.limits)
    action = interface.action.model_copy(update={"low": low, "high": high})
    return interface.model_copy(update={"action": action, "period": policy.period or interface.period})
