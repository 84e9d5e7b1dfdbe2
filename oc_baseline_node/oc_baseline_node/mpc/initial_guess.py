"""Initial guesses for the solvers: a line to the goal, straight or around obstacles, or a shifted trajectory."""

from __future__ import annotations

import numpy as np
from ctrl_rl_core.tasks import wrap
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from ctrl_rl_core import System
from oc_baseline_node.problems.problem import OptimalControlProblem

Array = NDArray[np.float64]
_SPACING = 0.1
"""Spacing of the planner's nodes [m]."""
_ROOM, _TIGHT_PENALTY = 0.15, 4.0
"""Clearance beyond d_min [m] below which a hop counts as longer, and the maximum relative penalty: solvers keep
slightly more than d_min, and a path through the middle of a door is easier to improve."""
_NEIGHBOURS = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2))
"""Neighbours of a node, without the opposite ones."""


class ShortestPathPlanner:
    """Finds shortest paths to a problem's goal that keep d_min, on a grid of positions.

    Args:
        problem: Optimal control problem with bounded positions.
    """

    def __init__(self, problem: OptimalControlProblem) -> None:
        self._problem = problem
        low, high = problem.state_bounds[:, problem.positions]
        sides = [np.arange(a, b, _SPACING) for a, b in zip(low, high, strict=True)]
        self._points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
        room = self._clearance_to_spare(self._points)
        free = room >= -1e-9
        graph = _graph(self._points, room, (len(sides[0]), len(sides[1])))
        goal = self._nearest(np.array(problem.goal), free)
        lengths, before = dijkstra(graph, indices=np.array([goal]), return_predecessors=True)
        self._reached, self._next = np.isfinite(lengths[0]), before[0]

    def is_straight(self, position: Array) -> bool:
        """Return whether the straight line from a position (2,) to the goal keeps d_min."""
        goal = np.array(self._problem.goal)
        count = max(2, round(np.hypot(*(goal - position)) / (0.25 * _SPACING)))
        return bool(
            (
                self._clearance_to_spare(position + np.linspace(0.0, 1.0, count)[:, None] * (goal - position)) >= -1e-9
            ).all()
        )

    def path(self, position: Array, count: int) -> Array:
        """Return a path of equidistant points (count, 2) [m] from a position (2,) to the goal."""
        node = self._nearest(position, self._reached)
        nodes = [node]
        while self._next[node] >= 0:
            node = int(self._next[node])
            nodes.append(node)
        corners = np.vstack((position, self._points[nodes], self._problem.goal))
        along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
        at = np.linspace(0.0, along[-1], count)
        return np.column_stack([np.interp(at, along, corners[:, axis]) for axis in (0, 1)])

    def _clearance_to_spare(self, points: Array) -> Array:
        """Return the clearance beyond d_min of positions (..., 2) [m]."""
        states = np.zeros((*points.shape[:-1], len(self._problem.system.states)))
        states[..., self._problem.positions] = points
        return self._problem.margin(states)

    def _nearest(self, position: Array, among: NDArray[np.bool_]) -> int:
        apart = np.where(among, np.sum((self._points - position) ** 2, axis=1), np.inf)
        return int(np.argmin(apart))


def _graph(points: Array, room: Array, shape: tuple[int, int]) -> csr_array:
    """Return the weighted lengths of hops between nodes (N, 2) with clearance (N,) [m]."""
    free = room >= -1e-9
    index = np.arange(len(points)).reshape(shape)
    rows, columns = [], []
    for i, j in _NEIGHBOURS:
        below = slice(max(0, -j), shape[1] - max(0, j))
        above = slice(max(0, j), shape[1] - max(0, -j))
        rows.append(index[: shape[0] - i, below].ravel())
        columns.append(index[i:, above].ravel())
    a, b = np.concatenate(rows), np.concatenate(columns)
    both = free[a] & free[b]
    a, b = a[both], b[both]
    tight = 1.0 - np.clip(np.minimum(room[a], room[b]) / _ROOM, 0.0, 1.0)
    lengths = np.hypot(*(points[a] - points[b]).T) * (1.0 + _TIGHT_PENALTY * tight)
    once = csr_array((lengths, (a, b)), shape=(len(points), len(points)))
    return once + once.T


_SMOOTH = 9
"""Number of points over which a path's direction is averaged, because the path runs on a lattice."""


class InitialGuesses:
    """Initial guesses for one problem.

    Args:
        problem: Optimal control problem to solve.
    """

    def __init__(self, problem: OptimalControlProblem) -> None:
        self._problem = problem
        self._planner = ShortestPathPlanner(problem) if problem.obstacles else None

    def __call__(self, start: Array) -> list[tuple[Array, Array]]:
        """Return initial states (H+1, n) and controls (H, m) from `start` (n,), the most promising guess first.

        The guess is a straight line to the goal, preceded by a path around any obstacle in the way. With a free time
        step, a car that arrives sooner forwards than backwards drives along the line: from a guess at rest facing away,
        a solver would drive backwards, even if that takes longer.
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
    """Return states (H+1, n) that move along `line` (H+1, 2) with decaying rates, and controls at rest (H, m)."""
    names, H = problem.system.state_names, problem.horizon
    states = np.tile(start, (H + 1, 1))
    states[:, problem.positions] = line
    dying = [index for index, name in enumerate(names) if name in ("v", "v_x", "v_z", "omega", "psi")]
    states[:, dying] *= 1.0 - np.linspace(0.0, 1.0, H + 1)[:, None]
    return states, np.tile(equilibrium_control(problem.system), (H, 1))


def path_following_guess(problem: OptimalControlProblem, start: Array, line: Array) -> tuple[Array, Array]:
    """Return states (H+1, n) of a car that drives along `line` (H+1, 2), and controls within their bounds (H, m).

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
    """Return whether the controls are the speed and the turn rate of a heading."""
    return "theta" in system.state_names and system.control_names == ("v", "omega")


def _is_sooner_forwards(system: System, start: Array, line: Array) -> bool:
    """Return whether a car reaches the end of a straight line (H+1, 2) sooner forwards, including its turn in place."""
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
    """Return states (H+1, n) that stay at `start` (n,) while its rates decay, and controls at rest (H, m)."""
    return straight_line_guess(problem, start, np.tile(start[problem.positions], (problem.horizon + 1, 1)))


def shift_trajectory(states: Array, controls: Array, steps: int) -> tuple[Array, Array]:
    """Shift a trajectory (H+1, n), (H, m) by `steps`; repeat its last state and control at the end."""
    index = np.minimum(np.arange(len(states)) + steps, len(states) - 1)
    return states[index], controls[np.minimum(index[:-1], len(controls) - 1)]


def equilibrium_control(system: System) -> Array:
    """Return the control (m,) within bounds that best holds the system at rest at the origin: zero, or hover."""
    n, m = len(system.states), len(system.controls)
    if not m:
        return np.zeros(0)
    with np.errstate(all="ignore"):
        drift = system.dynamics(np.zeros(n), np.zeros(m))
        effect = system.dynamics(np.zeros(n), np.eye(m)) - drift  # models are affine in u: row i is the effect of u_i
    if not (np.isfinite(drift).all() and np.isfinite(effect).all()):  # a model undefined at the origin
        return np.clip(np.zeros(m), *system.control_bounds)
    u = np.linalg.lstsq(effect.T, -drift, rcond=None)[0]
    return np.clip(u, *system.control_bounds)
