"""Model-based evaluation: a policy drives in a model of the robot's motion from the bags, among the task's walls.

The model is believed only where it replays the bags: recorded commands of episodes that it was not fitted to must end
in the model as they ended in the bag.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from ctrl_rl_core.policies import ScanPart
from numpy.typing import NDArray
from sim_bridge.engines import shape_row
from sim_bridge.fleet import scans

from ctrl_rl_core import Actor, NavigationTask, Outcome, TaskSets, drive_fleet, terminal_reward
from ctrl_rl_learning.offline.data.motion import Dynamics, displaced, displacements_before, fit_dynamics
from ctrl_rl_learning.offline.data.transitions import Transitions, sensed_interface
from ctrl_rl_learning.offline.evaluation.estimators import actions_of

Array = NDArray[np.float64]
_APART = 0.05
"""Distance between the places of a step at which outcomes are looked for [m]."""

_REPLAYED = 10

Choose = Callable[[Array, Array, NDArray[np.intp], int], NDArray[np.float32]]
"""Returns the actions (n, 2) at states (n, 3) after displacements (n, 3), of the episodes (n,), in a step."""


class LearntWorld:
    """A task's walls, goal and lidar, in which robots move by dynamics from bags."""

    def __init__(self, task: NavigationTask, dynamics: Dynamics, random: np.random.Generator) -> None:
        self._task, self._dynamics, self._random = task, dynamics, random
        self._sets = TaskSets(task)
        self._parts = sensed_interface(task).observation
        world = task.build_world()
        self._shapes = np.array([shape_row(shape) for shape in (*world.walls, *world.obstacles)])
        robot = task.robot.robot
        self._mount = (0.0, 0.0) if robot is None else (robot.lidar.x, robot.lidar.y)

    def drive(
        self, starts: Array, before: Array, steps: int, choose: Choose
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Drive episodes; return their outcomes (N,), and the number of the step that brought each (N,).

        Args:
            starts: States to start in (N, 3).
            before: Displacements of the step before (N, 3).
            steps: Number of steps after which an episode is left, still running.
            choose: Chooses the actions.
        """
        robots = _LearntRobots(self, starts, before)
        episodes = drive_fleet(robots, lambda sensed: choose(*sensed), range(len(starts)), steps)
        return robots.outcomes, episodes.steps - 1

    def move(self, states: Array, actions: NDArray[np.float32], moved: Array) -> tuple[Array, Array, NDArray[np.int64]]:
        """Return states (N, 3) and displacements (N, 3) after a step, and its outcomes (N,)."""
        following, moved = self._dynamics(states, actions, moved, self._random)
        return following, moved, self._outcomes(states, moved)

    def observe(self, states: Array, moved: Array) -> NDArray[np.float32]:
        """Return what a policy observes at states (N, 3) after displacements (N, 3), in SI units (N, n)."""
        period = self._task.episode.time_step
        known = dict(zip(("x", "y", "theta", "v", "omega"), (*states.T, *moved[:, [0, 2]].T / period), strict=True))
        columns = [
            self._ranges(part, states)
            if isinstance(part, ScanPart)
            else np.clip(
                np.stack([known[name] for name in part.names], axis=1), part.spread("low"), part.spread("high")
            )
            for part in self._parts
        ]
        return np.concatenate(columns, axis=1).astype(np.float32)

    def _ranges(self, part: ScanPart, states: Array) -> Array:
        """Return the ranges (N, beams) [m], with the noise and the lost beams of the task's lidar."""
        lidar, random = self._task.lidar, self._random
        ranges = np.empty((len(states), part.count))
        scans(self._shapes, displaced(states, np.array([(*self._mount, 0.0)])), part.bearings, part.high, ranges)
        ranges += lidar.noise * random.standard_normal(ranges.shape)
        ranges[random.random(ranges.shape) < lidar.dropout] = part.high
        return np.clip(ranges, part.low, part.high)

    def _outcomes(self, before: Array, moved: Array) -> NDArray[np.int64]:
        """Return the first outcome on the way of a step (N,)."""
        count = max(1, math.ceil(float(np.abs(moved[:, 0]).max()) / _APART))
        found = np.array([self._sets.outcomes(displaced(before, (k + 1) / count * moved)) for k in range(count)])
        first = (found != Outcome.RUNNING).argmax(axis=0)
        return found[first, np.arange(len(before))].astype(np.int64)


_Sensed = tuple[Array, Array, NDArray[np.intp], int]


class _LearntRobots:
    """Robots in a learnt world, side by side; those whose episodes have ended move no more."""

    def __init__(self, world: LearntWorld, starts: Array, before: Array) -> None:
        self._world, self._states, self._moved = world, starts.copy(), before.copy()
        self.outcomes, self._steps = np.zeros(len(starts), dtype=np.int64), 0

    def begin(self, _: Sequence[int]) -> tuple[_Sensed, Array]:
        """Return what is known at the start."""
        return self._sensed(), self._states.copy()

    def step(self, actions: NDArray[np.float32]) -> tuple[_Sensed, Array, Array, NDArray[np.int64]]:
        """Hold the actions of those that still drive (n, 2)."""
        states, moved, running, _ = self._sensed()
        self._states[running], self._moved[running], self.outcomes[running] = self._world.move(states, actions, moved)
        self._steps += 1
        return self._sensed(), self._states.copy(), np.zeros(len(self._states)), self.outcomes

    def _sensed(self) -> _Sensed:
        running = np.flatnonzero(self.outcomes == Outcome.RUNNING)
        return self._states[running], self._moved[running], running, self._steps


def can_model(task: NavigationTask) -> bool:
    """Return whether a task's world is the same in each episode, and its states are x, y, theta."""
    return task.system.build().state_names == ("x", "y", "theta") and not task.movers and task.doorways is None


def model_returns(
    transitions: Transitions, task: NavigationTask, actor: Actor, discount: float, fits: int, seed: int
) -> Array:
    """Return what a policy earns in the model from each start of the bags (fits, episodes), discounted.

    Each fit has a model of its own, of episodes drawn with replacement.
    """
    starts = transitions.states[transitions.first]
    out = []
    for fit in range(fits):
        random = np.random.default_rng((seed, fit))
        drawn = random.integers(len(starts), size=len(starts))
        world = LearntWorld(task, fit_dynamics(_episodes(transitions, drawn)), random)

        def choose(
            states: Array, moved: Array, _: NDArray[np.intp], __: int, world: LearntWorld = world
        ) -> NDArray[np.float32]:
            return actions_of(actor, world.observe(states, moved))

        outcomes, ends = world.drive(starts, np.zeros_like(starts), task.episode.steps, choose)
        outcomes[outcomes == Outcome.RUNNING] = Outcome.TIMEOUT
        out.append(terminal_reward(outcomes, task.rewards) * discount**ends)
    return np.array(out)


def replay_correlation(transitions: Transitions, task: NavigationTask, seed: int) -> float:
    """Return how well recorded commands end in the model as they did in the bag: -1 to 1, 0 where none differ.

    Pieces of `_REPLAYED` steps, counted from an episode's end, are replayed without a look at what comes of them: a
    policy that looks would mend the model's errors by then. What each earns is correlated with what it earned in the
    bag. Half of the episodes are replayed in a model of the other half, and the other way around; no policy takes part.
    """
    first = np.append(np.flatnonzero(transitions.first), len(transitions))
    before = displacements_before(transitions)
    pieces = [np.arange(low, high)[::-1][_REPLAYED - 1 :: _REPLAYED] for low, high in pairwise(first)]
    replayed, earned = [], []
    for half in range(2):
        fitted_to = np.arange(1 - half, len(pieces), 2)
        world = LearntWorld(task, fit_dynamics(_episodes(transitions, fitted_to)), np.random.default_rng((seed, half)))
        starts = np.concatenate(pieces[half::2])

        def choose(
            _: Array, __: Array, which: NDArray[np.intp], step: int, starts: NDArray[np.intp] = starts
        ) -> NDArray[np.float32]:
            return transitions.actions[starts[which] + step]

        outcomes, _ = world.drive(transitions.states[starts], before[starts], _REPLAYED, choose)
        replayed.append(terminal_reward(outcomes, task.rewards))
        earned.append(transitions.task_rewards[starts + _REPLAYED - 1])
    return correlation(np.concatenate(replayed), np.concatenate(earned))


def correlation(first: Array, second: Array) -> float:
    """Return the correlation of two rows of numbers (n,), 0 where one does not vary."""
    spread = first.std() * second.std()
    return 0.0 if spread == 0.0 else float(((first - first.mean()) * (second - second.mean())).mean() / spread)


def _episodes(transitions: Transitions, numbers: NDArray[np.intp]) -> Transitions:
    """Return the transitions of episodes, counted from 0, in the given order."""
    first = np.append(np.flatnonzero(transitions.first), len(transitions))
    return transitions.rows(np.concatenate([np.arange(first[number], first[number + 1]) for number in numbers]))
