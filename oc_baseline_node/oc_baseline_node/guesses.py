"""Where a solver begins: a straight line to the goal, or an earlier trajectory moved on by some steps."""

from __future__ import annotations

import numpy as np
from ctrl_rl_core.systems import System
from numpy.typing import NDArray

from oc_baseline_node.problem import Problem

Array = NDArray[np.float64]


def straight_line(problem: Problem, start: Array) -> tuple[Array, Array]:
    """Return states (H+1, n) that slide from `start` (n,) to the goal, rates dying out, and resting controls (H, m)."""
    names, H = problem.system.state_names, problem.horizon
    share = np.linspace(0.0, 1.0, H + 1)[:, None]
    states = np.tile(start, (H + 1, 1))
    place = problem.positions
    states[:, place] += share * (np.array(problem.goal) - start[place])
    dying = [index for index, name in enumerate(names) if name in ("v", "v_x", "v_z", "omega", "psi")]
    states[:, dying] *= 1.0 - share
    return states, np.tile(resting_control(problem.system), (H, 1))


def moved_on(states: Array, controls: Array, steps: int) -> tuple[Array, Array]:
    """Return a trajectory (H+1, n), (H, m) from `steps` on, its last state and control repeated to the same length."""
    index = np.minimum(np.arange(len(states)) + steps, len(states) - 1)
    return states[index], controls[np.minimum(index[:-1], len(controls) - 1)]


def resting_control(system: System) -> Array:
    """Return the control (m,) within bounds that comes nearest to rest at the origin: zero, or hover in flight."""
    n, m = len(system.states), len(system.controls)
    drift = system.dynamics(np.zeros(n), np.zeros(m))
    effect = system.dynamics(np.zeros(n), np.eye(m)) - drift  # models are affine in u: row i is the effect of u_i
    u = np.linalg.lstsq(effect.T, -drift, rcond=None)[0]
    return np.clip(u, *system.control_bounds)
