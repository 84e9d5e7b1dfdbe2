"""Random states: starts drawn uniformly from the optimal control state space, and states in collision (3.3.2)."""

from __future__ import annotations

import numpy as np
from ctrl_rl_core.regions import position_indices
from ctrl_rl_core.task_sets import TaskSets
from numpy.typing import NDArray

from oc_baseline_node.errors import OcError
from oc_baseline_node.problem import Problem

Array = NDArray[np.float64]
_TRIES = 10_000


def state_space(problem: Problem) -> Array:
    """Return least and largest start (2, n): the problem's bounds, the model's own where the problem has none."""
    own = np.array([[s.lower for s in problem.system.states], [s.upper for s in problem.system.states]])
    space = np.where(np.isfinite(problem.state_bounds), problem.state_bounds, own)
    if not np.isfinite(space).all():
        name = problem.system.state_names[int(np.argmin(np.isfinite(space).all(axis=0)))]
        raise OcError(f"task '{problem.task.name}': '{name}' has no bounds to draw starts from: add them to "
                      "optimal_control.bounds")  # fmt: skip
    return space


def draw_start(problem: Problem, random: np.random.Generator) -> Array:
    """Return one state (n,) drawn uniformly from the state space less the obstacles grown by d_min.

    Raises:
        OcError: there is hardly any free space.
    """
    low, high = state_space(problem)
    for _ in range(_TRIES):
        state = random.uniform(low, high)
        if not problem.refusal(state):
            return state
    raise OcError(f"task '{problem.task.name}': no free start in {_TRIES} tries: obstacles fill the map")


def draw_collisions(problem: Problem, density: float, random: np.random.Generator) -> Array:
    """Return states (k, n) drawn uniformly from the part of the arena in which the body collides.

    Args:
        problem: whose state space the other components come from.
        density: how many of them to a square metre of that part.
        random: draws them.
    """
    task = problem.task
    assert task.arena is not None
    low, high = state_space(problem)
    place = position_indices(problem.system.state_names)
    low[place], high[place] = np.array(task.arena.bounds).T
    area = float(np.prod(high[place] - low[place]))
    states = random.uniform(low, high, (round(density * area), len(low)))
    return states[TaskSets(task).clearance(states) <= 0.0]


def free_area(problem: Problem, random: np.random.Generator, samples: int = 20_000) -> float:
    """Return the area in which starts are drawn [m^2], by sampling."""
    space = state_space(problem)
    inside = problem.margin(random.uniform(*space, (samples, space.shape[1]))) >= 0.0
    return float(np.prod(np.diff(space[:, problem.positions], axis=0)) * inside.mean())
