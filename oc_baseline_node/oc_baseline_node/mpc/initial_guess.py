"""Initial guesses of the solvers: a line to the goal, straight or round obstacles, or a shifted trajectory."""

from __future__ import annotations

import numpy as np
from ctrl_rl_core.tasks.regions import wrap
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from ctrl_rl_core import System
from oc_baseline_node.mpc.shortest_path import ShortestPathPlanner
from oc_baseline_node.problems.problem import OptimalControlProblem

Array = NDArray[np.float64]
_SMOOTH = 9
"""Number of points over which the direction of a path is averaged, because it leads over a lattice."""


class InitialGuesses:
    """Initial guesses for one problem.

    Args:
        problem: Optimal control problem to be solved.
    """

    def __init__(self, problem: OptimalControlProblem) -> None:
        self._problem = problem
        self._planner = ShortestPathPlanner(problem) if problem.obstacles else None

    def __call__(self, start: Array) -> list[tuple[Array, Array]]:
        """Return states (H+1, n) and controls (H, m) to begin with from `start` (n,), the likeliest first.

        A straight line to the goal; where that runs through an obstacle, a path round it comes first. With a free time
        step a car that would be there sooner forwards than backwards drives along it: without speeds to begin with, and
        facing away, a solver finds the way backwards, however long that takes.
        """
        count = self._problem.horizon + 1
        position = start[self._problem.positions]
        straight = position + np.linspace(0.0, 1.0, count)[:, None] * (np.array(self._problem.goal) - position)
        if self._planner is not None and not self._planner.is_straight(position):
            round_ = self._planner.path(position, count)
            return [
                path_following_guess(self._problem, start, round_),
                straight_line_guess(self._problem, start, straight),
            ]
        if self._problem.form == "free_time" and _is_sooner_forwards(self._problem.system, start, straight):
            return [path_following_guess(self._problem, start, straight)]
        return [straight_line_guess(self._problem, start, straight)]


def straight_line_guess(problem: OptimalControlProblem, start: Array, line: Array) -> tuple[Array, Array]:
    """Return states (H+1, n) that slide along `line` (H+1, 2), rates dying out, and resting controls (H, m)."""
    names, H = problem.system.state_names, problem.horizon
    states = np.tile(start, (H + 1, 1))
    states[:, problem.positions] = line
    dying = [index for index, name in enumerate(names) if name in ("v", "v_x", "v_z", "omega", "psi")]
    states[:, dying] *= 1.0 - np.linspace(0.0, 1.0, H + 1)[:, None]
    return states, np.tile(equilibrium_control(problem.system), (H, 1))


def path_following_guess(problem: OptimalControlProblem, start: Array, line: Array) -> tuple[Array, Array]:
    """Return states (H+1, n) of a car that drives along `line` (H+1, 2), and its controls (H, m) within their bounds.

    A system without heading, or one that flies, gets `straight_line_guess` instead.
    """
    states, controls = straight_line_guess(problem, start, line)
    names = problem.system.state_names
    if not _is_car(problem.system):
        return states, controls
    ahead = np.diff(uniform_filter1d(line, _SMOOTH, axis=0, mode="nearest"), axis=0)
    heading = np.unwrap(np.concatenate(([start[names.index("theta")]], np.arctan2(ahead[:, 1], ahead[:, 0]))))
    states[:, names.index("theta")] = heading
    rates = np.column_stack((np.hypot(*ahead.T), np.diff(heading))) / problem.time_step
    return states, np.clip(rates, *problem.system.control_bounds)


def _is_car(system: System) -> bool:
    """Whether speed and turn rate of a heading are the controls."""
    return "theta" in system.state_names and system.control_names == ("v", "omega")


def _is_sooner_forwards(system: System, start: Array, line: Array) -> bool:
    """Whether a car that turns on the spot first is sooner at the end of a straight line (H+1, 2) forwards."""
    if not _is_car(system):
        return False
    (back, _), (ahead, turn) = system.control_bounds
    if back >= 0.0 or min(ahead, turn) <= 0.0:
        return back >= 0.0
    x, y = line[-1] - line[0]
    angle = abs(wrap(np.arctan2(y, x) - start[system.state_names.index("theta")]))
    length = np.hypot(x, y)
    return bool(angle / turn + length / ahead <= (np.pi - angle) / turn + length / -back)


def braking_guess(problem: OptimalControlProblem, start: Array) -> tuple[Array, Array]:
    """Return states (H+1, n) that stay where `start` (n,) is while its rates die out, and resting controls (H, m)."""
    return straight_line_guess(problem, start, np.tile(start[problem.positions], (problem.horizon + 1, 1)))


def shift_trajectory(states: Array, controls: Array, steps: int) -> tuple[Array, Array]:
    """Return a trajectory (H+1, n), (H, m) from `steps` on, its last state and control repeated to the same length."""
    index = np.minimum(np.arange(len(states)) + steps, len(states) - 1)
    return states[index], controls[np.minimum(index[:-1], len(controls) - 1)]


def equilibrium_control(system: System) -> Array:
    """Return the control (m,) within bounds that comes nearest to rest at the origin: zero, or hover in flight."""
    n, m = len(system.states), len(system.controls)
    if not m:
        return np.zeros(0)
    with np.errstate(all="ignore"):
        drift = system.dynamics(np.zeros(n), np.zeros(m))
        effect = system.dynamics(np.zeros(n), np.eye(m)) - drift  # models are affine in u: row i is the effect of u_i
    if not (np.isfinite(drift).all() and np.isfinite(effect).all()):  # a model without a value at the origin
        return np.clip(np.zeros(m), *system.control_bounds)
    u = np.linalg.lstsq(effect.T, -drift, rcond=None)[0]
    return np.clip(u, *system.control_bounds)
