"""Model-based evaluation: a policy drives in a model of the robot's motion from the bags, among walls and movers.

Several models take part: each fit has drawn its own episodes, and goes on beyond the recorded speeds in two ways. In
the second way the robot gets no faster than it was recorded, and whoever leaves the region that the bags know has
collided. `support` says whether the models may be believed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from ctrl_rl_core.policies import ScanPart
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ctrl_rl_core import Actor, NavigationTask, Outcome, drive_fleet, terminal_reward
from ctrl_rl_learning.offline.data.motion import displaced
from ctrl_rl_learning.offline.data.transitions import Transitions, sensed_interface
from ctrl_rl_learning.offline.evaluation.dynamics import Dynamics, fit_dynamics, inputs_of
from ctrl_rl_learning.offline.evaluation.estimators import actions_of
from ctrl_rl_learning.offline.evaluation.recorded import Recorded
from ctrl_rl_learning.offline.evaluation.surroundings import Surroundings, on_the_way
from ctrl_rl_learning.offline.witness.movers import draw_plans
from ctrl_rl_learning.offline.witness.record import lidar_place

Array = NDArray[np.float64]
_APART = 0.05
"""Distance between the places of a step at which outcomes are looked for [m]."""


Index = NDArray[np.intp]
Choose = Callable[[Array, Array, Index, int], NDArray[np.float32]]
"""Returns the actions (n, 2) at states (n, 3) after displacements (n, 3), of the episodes (n,), in a step."""


class Fence:
    """A region: all within reach of places.

    Args:
        states: States at those places (N, 3).
        reach: Distance to the nearest place up to which a state lies within [m].
    """

    def __init__(self, states: Array, reach: float) -> None:
        self._places, self._reach = cKDTree(states[:, :2]), reach

    def nearest(self, states: Array) -> tuple[Array, NDArray[np.intp]]:
        """Return the distance (N,) [m] of states (N, 3) to the nearest place, and its number (N,)."""
        distances, numbers = self._places.query(states[:, :2])
        return np.asarray(distances), np.asarray(numbers)

    def leaves(self, states: Array) -> NDArray[np.bool_]:
        """Return whether states (N, 3) lie outside (N,)."""
        return self.nearest(states)[0] > self._reach


def reach_of(task: NavigationTask) -> float:
    """Return how far around a recorded place a lidar shows what stands there, even if it has few beams [m]."""
    return float(np.clip(0.1 * task.lidar.range.high, 0.3, 1.0))


class LearntWorld:
    """A task's walls, movers, goal and lidar, in which robots move by dynamics from bags.

    Args:
        task: Task of the robots.
        dynamics: How they move.
        around: Walls and movers of the episodes.
        random: Draws the errors of motion and lidar.
        fence: Region that no robot may leave, if there is one.

    Attributes:
        rest: Action (2,) of a robot at rest.
        fence: Region that no robot may leave, if there is one.
    """

    def __init__(
        self,
        task: NavigationTask,
        dynamics: Dynamics,
        around: Surroundings,
        random: np.random.Generator,
        fence: Fence | None = None,
    ) -> None:
        self._task, self._dynamics, self._around, self._random, self.fence = task, dynamics, around, random, fence
        self.rest = rest_of(task)
        self._parts = sensed_interface(task).observation
        self._mount = np.array([(*lidar_place(task), 0.0)])
        self._noise, self._dropout = np.zeros((0, 1)), np.zeros((0, 1))

    def drive(
        self, starts: Array, inputs: Array, steps: int, choose: Choose
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        """Drive episodes; return their outcomes (N,), the number of the step that brought each (N,), and where (N, 3).

        Args:
            starts: States to start in (N, 3).
            inputs: Inputs of the first step (N, 7), of which the actions do not count.
            steps: Number of steps after which an episode is left, still running.
            choose: Chooses the actions.
        """
        lidar, drawn, shape = self._task.lidar, self._task.randomisation, (len(starts), 1)
        self._noise, self._dropout = (
            self._random.uniform(*drawn[name], shape) if name in drawn else np.full(shape, own)
            for name, own in (("scan_noise", lidar.noise), ("scan_dropout", lidar.dropout))
        )
        robots = _LearntRobots(self, starts, inputs)
        episodes = drive_fleet(robots, lambda sensed: choose(*sensed), range(len(starts)), steps)
        return robots.outcomes, episodes.steps - 1, robots.states

    def move(self, which: Index, states: Array, inputs: Array) -> tuple[Array, Array, NDArray[np.int64]]:
        """Return states (n, 3), displacements (n, 3) and outcomes (n,) of episodes after a step with inputs (n, 7)."""
        following, moved = self._dynamics(states, inputs, self._random)
        outcomes = self._first_outcomes(which, states, moved)
        if self.fence is not None:
            outcomes[(outcomes == Outcome.RUNNING) & self.fence.leaves(following)] = Outcome.COLLISION
        return following, moved, outcomes

    def observe(self, which: Index, states: Array, moved: Array) -> NDArray[np.float32]:
        """Return what a policy observes at states (n, 3) after displacements (n, 3), in SI units (n, size)."""
        period = self._task.episode.time_step
        known = dict(zip(("x", "y", "theta", "v", "omega"), (*states.T, *moved[:, [0, 2]].T / period), strict=True))
        columns = [
            self._ranges(part, which, states)
            if isinstance(part, ScanPart)
            else np.clip(
                np.stack([known[name] for name in part.names], axis=1), part.spread("low"), part.spread("high")
            )
            for part in self._parts
        ]
        return np.concatenate(columns, axis=1).astype(np.float32)

    def _ranges(self, part: ScanPart, which: Index, states: Array) -> Array:
        """Return the ranges (n, beams) [m], with the noise and the lost beams of the task's lidar."""
        ranges = self._around.ranges(which, displaced(states, self._mount), part)
        ranges += self._noise[which] * self._random.standard_normal(ranges.shape)
        ranges[self._random.random(ranges.shape) < self._dropout[which]] = part.high
        return np.clip(ranges, part.low, part.high)

    def _first_outcomes(self, which: Index, before: Array, moved: Array) -> NDArray[np.int64]:
        """Return the first outcome on the way of a step (n,), on which movers move, too."""
        found, pieces = [], self._around.mover_steps
        ways = list(on_the_way(before, moved, _APART, pieces))
        for number, states in enumerate(ways):
            if pieces and number % (len(ways) // pieces) == 0:
                self._around.advance(which, states)
                self._around.tick(self._task.episode.time_step / pieces)
            found.append(self._around.outcomes(which, states))
        each = np.array(found)
        first = (each != Outcome.RUNNING).argmax(axis=0)
        return each[first, np.arange(len(before))].astype(np.int64)


_Sensed = tuple[Array, Array, Index, int]


class _LearntRobots:
    """Robots in a learnt world, side by side; those whose episodes have ended move no more."""

    def __init__(self, world: LearntWorld, starts: Array, inputs: Array) -> None:
        self._world, self.states = world, starts.copy()
        self._moved, self._actions = inputs[:, 2:5].copy(), inputs[:, 5:].copy()
        self.outcomes, self._steps = np.zeros(len(starts), dtype=np.int64), 0

    def begin(self, _: Sequence[int]) -> tuple[_Sensed, Array]:
        """Return what is known at the start."""
        return self._sensed(), self.states.copy()

    def step(self, actions: NDArray[np.float32]) -> tuple[_Sensed, Array, Array, NDArray[np.int64]]:
        """Hold the actions of those that still drive (n, 2)."""
        states, moved, running, _ = self._sensed()
        inputs = inputs_of(actions, moved, self._actions[running])
        self.states[running], self._moved[running], self.outcomes[running] = self._world.move(running, states, inputs)
        self._actions[running] = actions
        self._steps += 1
        return self._sensed(), self.states.copy(), np.zeros(len(self.states)), self.outcomes

    def _sensed(self) -> _Sensed:
        running = np.flatnonzero(self.outcomes == Outcome.RUNNING)
        return self.states[running], self._moved[running], running, self._steps


def can_model(task: NavigationTask) -> bool:
    """Return whether the states of a task are x, y, theta."""
    return task.system.build().state_names == ("x", "y", "theta")


def rest_of(task: NavigationTask) -> Array:
    """Return the action (2,) of a robot of a task on wheels that stands still."""
    low, high = np.array(list(task.robot.commands.values())).T
    return np.clip(-(high + low) / (high - low), -1.0, 1.0)


@dataclass(frozen=True)
class RollOuts:
    """Roll-outs of a policy from each start of the bags, in several models.

    Attributes:
        returns: Discounted returns (models, episodes); in the second half of the models, those that go on beyond the
            bags with more caution.
        success: Whether the goal was reached (models, episodes).
        states: States that the policy visited in the first half of the models (M, 3).
        actions: Its actions there (M, 2).
        moved: Displacements of the steps before (M, 3).
    """

    returns: Array
    success: NDArray[np.bool_]
    states: Array
    actions: NDArray[np.float32]
    moved: Array


def roll_out(recorded: Recorded, actor: Actor, discount: float, fits: int, seed: int) -> RollOuts:
    """Return roll-outs of a policy from each start of the bags; each fit has a model of episodes drawn for it.

    Walls are those of each episode, as far as its scans show them; movers are drawn anew in each model.
    """
    transitions, task = recorded.transitions, recorded.task
    starts, fence = transitions.states[transitions.first], Fence(transitions.states, reach_of(task))
    visited: list[tuple[Array, NDArray[np.float32], Array]] = []
    ended = []
    for cautious in (False, True):
        for fit in range(fits):
            random = np.random.default_rng((seed, fit))
            drawn = random.integers(len(starts), size=len(starts))
            dynamics = replace(fit_dynamics(episodes_of(transitions, drawn), rest_of(task)), capped=cautious)
            plans = draw_plans(task, recorded.worlds, starts, random)
            around = Surroundings(task, recorded.worlds, plans=plans)
            world = LearntWorld(task, dynamics, around, random, fence if cautious else None)

            def choose(
                states: Array, moved: Array, which: Index, _: int, world: LearntWorld = world
            ) -> NDArray[np.float32]:
                actions = actions_of(actor, world.observe(which, states, moved))
                if world.fence is None:
                    visited.append((states.copy(), actions, moved.copy()))
                return actions

            outcomes, steps, _ = world.drive(starts, at_rest(world, len(starts)), task.episode.steps, choose)
            outcomes[outcomes == Outcome.RUNNING] = Outcome.TIMEOUT
            ended.append((terminal_reward(outcomes, task.rewards) * discount**steps, outcomes == Outcome.GOAL))
    returns, success = (np.array(each) for each in zip(*ended, strict=True))
    states, actions, moved = (np.concatenate(each) for each in zip(*visited, strict=True))
    return RollOuts(returns, success, states, actions, moved)


def at_rest(world: LearntWorld, count: int) -> Array:
    """Return the inputs (count, 7) of robots that stand still."""
    return np.tile(np.concatenate((world.rest, np.zeros(3), world.rest)), (count, 1))


def episodes_of(transitions: Transitions, numbers: NDArray[np.intp]) -> Transitions:
    """Return the transitions of episodes, counted from 0, in the given order."""
    first = np.append(np.flatnonzero(transitions.first), len(transitions))
    return transitions.rows(np.concatenate([np.arange(first[number], first[number + 1]) for number in numbers]))
