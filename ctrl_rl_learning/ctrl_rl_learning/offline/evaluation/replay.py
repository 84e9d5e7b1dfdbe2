"""Held-out pieces of the bags, replayed in models of the others: whether a model moves as the robot did."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import terminal_reward
from ctrl_rl_learning.offline.data.motion import displacements
from ctrl_rl_learning.offline.evaluation.dynamics import fit_dynamics, recorded_inputs
from ctrl_rl_learning.offline.evaluation.recorded import Recorded
from ctrl_rl_learning.offline.evaluation.roll_outs import LearntWorld, episodes_of, rest_of
from ctrl_rl_learning.offline.evaluation.surroundings import Surroundings

Array = NDArray[np.float64]
REPLAYED = 10
"""Steps of a piece of the bags that is replayed."""


class Replay(NamedTuple):
    """Held-out pieces of the bags, replayed in a model.

    Attributes:
        rows: Transition that begins each piece (n,).
        replayed: Rewards at the end of the pieces in the model (n,).
        again: The same with other errors of the model (n,).
        earned: The same in the bag (n,).
        missed: Distance between the places where model and bag end [m] (n,).
        driven: Length of the way in the bag [m] (n,).
    """

    rows: NDArray[np.intp]
    replayed: Array
    again: Array
    earned: Array
    missed: Array
    driven: Array

    @property
    def agreement(self) -> float:
        """Correlation between the returns of recorded and replayed pieces, -1 to 1."""
        return correlation(self.replayed, self.earned)

    @property
    def attainable(self) -> float:
        """Correlation between two replays: what a model agrees by with a robot that moves as it says, -1 to 1."""
        return correlation(self.replayed, self.again)


def replay(recorded: Recorded, seed: int) -> Replay:
    """Replay recorded commands in a model of other episodes, among the walls of their own and without movers.

    Pieces of `REPLAYED` steps, counted from an episode's end, are replayed without a look at what comes of them: a
    policy that looks would mend the model's errors by then. The faster the drives, the farther apart even two replays
    of a piece end: `attainable` is what the agreement of a true model comes to. Half of the episodes are replayed in a
    model of the other half, and the other way around; no policy takes part. Pieces that a mover ended are left out.
    """
    transitions, task = recorded.transitions, recorded.task
    first = np.append(np.flatnonzero(transitions.first), len(transitions))
    inputs = recorded_inputs(transitions, rest_of(task))
    way = np.append(0.0, np.cumsum(np.abs(displacements(transitions)[:, 0])))
    pieces = [np.arange(low, high)[::-1][REPLAYED - 1 :: REPLAYED] for low, high in pairwise(first)]
    hits, episodes = recorded.hits_of_movers, recorded.episodes
    found: list[Replay] = []
    for half in range(2):
        fitted_to = np.arange(1 - half, len(pieces), 2)
        dynamics = fit_dynamics(episodes_of(transitions, fitted_to), rest_of(task))
        starts = np.concatenate([np.zeros(0, dtype=np.intp), *pieces[half::2]])
        starts = starts[~hits[starts + REPLAYED - 1]]
        if not len(starts):
            continue
        around = Surroundings(task, recorded.worlds, episodes[starts])

        def choose(
            _: Array, __: Array, which: NDArray[np.intp], step: int, starts: NDArray[np.intp] = starts
        ) -> NDArray[np.float32]:
            return transitions.actions[starts[which] + step]

        rewards = []
        for drawn in ((seed, half, 1), (seed, half)):
            world = LearntWorld(task, dynamics, around, np.random.default_rng(drawn))
            outcomes, _, ends = world.drive(transitions.states[starts], inputs[starts], REPLAYED, choose)
            rewards.append(np.asarray(terminal_reward(outcomes, task.rewards)))
        last = starts + REPLAYED - 1
        missed = np.hypot(*(ends - transitions.next_states[last])[:, :2].T)
        again, replayed = rewards
        earned, driven = transitions.task_rewards[last], way[last + 1] - way[starts]
        found.append(Replay(starts, replayed, again, earned, missed, driven))
    none = Replay(np.zeros(0, dtype=np.intp), *np.zeros((5, 0)))
    return Replay(*(np.concatenate(column) for column in zip(none, *found, strict=True)))


def correlation(first: Array, second: Array) -> float:
    """Return the correlation of two rows of numbers (n,), 0 where one does not vary."""
    spread = first.std() * second.std() if len(first) else 0.0
    return 0.0 if spread == 0.0 else float(((first - first.mean()) * (second - second.mean())).mean() / spread)
