"""States of the Dubins car with exact times to reach: a reference independent of the solvers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Interval
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.verification.dubins import stays_in, to_box

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reference:
    """States (N, 3) and their exact times to reach (N,) [s]."""

    states: Array
    times: Array


def reference(problem: TimeToReachProblem, count: int = 5000, seed: int = 0) -> Reference:
    """Draw random states outside the target whose shortest path stays on the grid, with their exact times.

    Args:
        problem: Dubins car at 1 m/s and up to 1 rad/s with a box as the target; obstacles are ignored.
        count: Number of random states.
        seed: Random seed for the states.

    Raises:
        TimeToReachError: Another system or target.
    """
    names, target = problem.system.state_names, problem.target.intervals
    bounds = problem.system.control_bounds.T.tolist()
    if names != ("x", "y", "theta") or bounds != [[1.0, 1.0], [-1.0, 1.0]] or set(target) != set(names):
        raise TimeToReachError("exact times are known for the Dubins car of 1 m/s and 1 rad/s to a box of poses")
    sides: list[Interval] = [target[name] for name in names]
    box = np.array([(side.low, side.high) for side in sides])
    lower, upper = np.array([(axis.lower, axis.upper) for axis in problem.axes]).T
    low, high = float(max(lower[:2])), float(min(upper[:2]))
    random = np.random.default_rng(seed)
    states, times = np.empty((0, 3)), np.empty(0)
    while len(times) < count:
        some = random.uniform(lower, upper, (count, 3))
        lengths, paths = to_box(some, box)
        kept = stays_in(some, paths, low, high) & (lengths > 0.0)
        states, times = np.concatenate((states, some[kept])), np.concatenate((times, lengths[kept]))
    return Reference(states[:count], times[:count])
