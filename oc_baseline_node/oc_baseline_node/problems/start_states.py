"""Random start states, drawn uniformly from the optimal control state space (thesis 3.3.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oc_baseline_node.errors import OcError
from oc_baseline_node.problems.problem import OptimalControlProblem

Array = NDArray[np.float64]
_TRIES = 10_000


def state_space(problem: OptimalControlProblem) -> Array:
    """Return the bounds of start states (2, n): the problem's, or else the model's."""
    own = np.array([[s.lower for s in problem.system.states], [s.upper for s in problem.system.states]])
    space = np.where(np.isfinite(problem.state_bounds), problem.state_bounds, own)
    if not np.isfinite(space).all():
        name = problem.system.state_names[int(np.argmin(np.isfinite(space).all(axis=0)))]
        raise OcError(f"task '{problem.task.name}': '{name}' has no bounds to draw starts from: add them to "
                      "optimal_control.bounds")  # fmt: skip
    return space


def draw_episode_start(problem: OptimalControlProblem, random: np.random.Generator) -> Array:
    """Draw one state (n,) from the task's start set, in the problem's coordinates."""
    return problem.task.start.region.sample(problem.system.state_names, random)


def draw_start(problem: OptimalControlProblem, random: np.random.Generator) -> Array:
    """Draw one state (n,) uniformly from the state space outside the obstacles inflated by d_min.

    Raises:
        OcError: There is almost no free space.
    """
    low, high = state_space(problem)
    for _ in range(_TRIES):
        state = random.uniform(low, high)
        if not problem.refusal(state):
            return state
    raise OcError(f"task '{problem.task.name}': no free start in {_TRIES} tries: obstacles fill the map")
