"""Transcription to a nonlinear program by multiple shooting, in the stage order required by fatrop.

Variables: x_0, u_0, x_1, ..., u_{H-1}, x_H, without fixed controls; a free time step is an additional state.
Constraints of a stage: the next state, then (at k = 0) the start, the obstacles, (at k = H) the terminal disc.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import casadi
import numpy as np
from ctrl_rl_core.io import one_line
from numpy.typing import NDArray

from ctrl_rl_core import Region
from oc_baseline_node.errors import OcError
from oc_baseline_node.mpc.obstacles import covering_superellipses
from oc_baseline_node.mpc.rounded import rounded
from oc_baseline_node.problems.problem import TIME_STEP_RANGE, OptimalControlProblem

Array = NDArray[np.float64]
SolverName = Literal["ipopt", "fatrop"]
Kind = Literal["dynamics", "start", "obstacle", "disc"]
_LEAST_CLEARANCE = 0.05
"""Minimum d_min used in the corner-cutting allowance [m], which would be infinite for a corner that may be touched."""
_COST_RANGE = 1e3
"""Maximum weight of a squared distance [1/m^2] after scaling, since gamma^H alone is 6e5."""


class Layout:
    """Positions of states, controls and time step in the vector of variables."""

    def __init__(self, problem: OptimalControlProblem) -> None:
        low, high = problem.system.control_bounds
        self.problem = problem
        self.n = len(problem.system.states)
        self.free_controls = np.flatnonzero(low < high)
        self.held = low.copy()
        self.free_time = problem.form == "free_time"
        self.width = self.n + self.free_time + len(self.free_controls)
        self.size = problem.horizon * self.width + self.n + self.free_time

    def pack(self, states: Array, controls: Array, time_step: float) -> Array:
        """Return the variables (size,) of states (H+1, n), controls (H, m) and a time step [s]."""
        H, n = self.problem.horizon, self.n
        rows = np.zeros((H + 1, self.width))
        rows[:, :n] = states
        if self.free_time:
            rows[:, n] = time_step
        rows[:H, n + self.free_time :] = controls[:, self.free_controls]
        return rows.ravel()[: self.size]

    def unpack(self, variables: Array) -> tuple[Array, Array, float]:
        """Return states (H+1, n), controls (H, m) and the time step [s]."""
        H, n = self.problem.horizon, self.n
        padded = np.zeros((H + 1) * self.width)
        padded[: self.size] = variables
        rows = padded.reshape(H + 1, self.width)
        controls = np.tile(self.held, (H, 1))
        controls[:, self.free_controls] = rows[:H, n + self.free_time :]
        time_step = float(rows[0, n]) if self.free_time else self.problem.time_step
        return rows[:, :n].copy(), controls, time_step


@dataclass(frozen=True)
class NonlinearProgram:
    """A nonlinear program with its solver.

    Attributes:
        layout: Positions of states and controls in the vector of variables.
        solver: CasADi function of the solver; its parameter is the start x_0.
        bounds: Bounds of the constraints, lbg and ubg; the bounds of the variables depend on the start.
        kinds: Kind of each constraint (M,).
        stages: Stage k of each constraint (M,).
    """

    layout: Layout
    solver: Any
    bounds: dict[str, Array]
    kinds: NDArray[np.str_]
    stages: NDArray[np.intp]


def transcribe(problem: OptimalControlProblem, solver: SolverName, max_iterations: int) -> NonlinearProgram:
    """Return the problem's program with its solver; the setup takes about a second."""
    layout = Layout(problem)
    H, n = problem.horizon, layout.n
    rates, _ = model_rates(problem)
    start = casadi.SX.sym("x0", n)
    X = [casadi.SX.sym(f"x_{k}", n + layout.free_time) for k in range(H + 1)]
    U = [casadi.SX.sym(f"u_{k}", len(layout.free_controls)) for k in range(H)]
    ellipses = [ellipse for shape in problem.obstacles for ellipse in covering_superellipses(shape, problem.clearance)]
    heaviest = problem.state_weight * problem.gamma**H
    scale = _COST_RANGE / max(heaviest, _COST_RANGE)
    g: list[Any] = []
    table: list[tuple[Kind, int, float, float]] = []

    def constrain(kind: Kind, k: int, expression: Any, least: float, most: float) -> None:
        g.append(expression)
        table.extend([(kind, k, least, most)] * expression.numel())

    cost = 0.0
    for k in range(H + 1):
        p = X[k][problem.positions]
        if k < H:
            u = _controls(layout, U[k])
            step = X[k][n] if layout.free_time else problem.time_step
            x_next = _runge_kutta(rates, X[k][:n], u, step)
            if layout.free_time:
                x_next = casadi.vertcat(x_next, X[k][n])
            constrain("dynamics", k, X[k + 1] - x_next, 0.0, 0.0)
            cost += scale * stage_cost(problem, p, u, k) * (step / problem.time_step)
        if k == 0:
            constrain("start", k, X[0][:n] - start, 0.0, 0.0)
        else:
            sag = 0.0 if k == H or not ellipses else corner_cutting_allowance(problem, rates(X[k][:n], u), step)
            for ellipse in ellipses:
                constrain("obstacle", k, ellipse.outside(p[0], p[1]) - sag, 0.0, math.inf)
    if problem.terminal.disc is not None:
        disc = problem.terminal.disc
        offset = X[H][problem.positions] - casadi.DM(disc.centre)
        constrain("disc", H, casadi.sumsqr(offset), 0.0, disc.radius**2)
    variables = [piece for pair in zip(X, [*U, casadi.SX(0, 1)], strict=True) for piece in pair]
    nlp = {"x": casadi.vertcat(*variables), "f": cost, "g": casadi.vertcat(*g), "p": start}
    kinds, stages, low, high = (np.array(column) for column in zip(*table, strict=True))
    options = _options(solver, max_iterations, (low == high).tolist())
    bounds = {"lbg": low, "ubg": high}
    return NonlinearProgram(layout, casadi.nlpsol("mpc", solver, nlp, options), bounds, kinds, stages)


def model_rates(problem: OptimalControlProblem) -> tuple[Any, tuple[str, ...]]:
    """Return x'(x, u) for CasADi without corners, and the smoothed operations; smooth models are unchanged.

    Raises:
        OcError: The model's equations do not work with CasADi.
    """
    x, u = (casadi.SX.sym(name, len(parts)) for name, parts in (("x", problem.system.states),
                                                                ("u", problem.system.controls)))  # fmt: skip
    try:
        own = casadi.Function("rates", [x, u], [problem.system.dynamics(x, u, math=casadi)])
    except (AttributeError, TypeError, NotImplementedError) as error:  # raised by the user's equations
        said = one_line(str(error).partition("\n")[0])
        raise OcError(f"model '{problem.system.name}': CasADi cannot differentiate it: {said}") from None
    function, names = rounded(own)
    if function is not own:
        return function, names
    return lambda x, u: problem.system.dynamics(x, u, math=casadi), ()


def _runge_kutta(rates: Any, x: Any, u: Any, dt: Any) -> Any:
    """Return the state after `dt` seconds, as `System.step` does."""
    k1 = rates(x, u)
    k2 = rates(x + dt / 2 * k1, u)
    k3 = rates(x + dt / 2 * k2, u)
    k4 = rates(x + dt * k3, u)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def corner_cutting_allowance(problem: OptimalControlProblem, rates: Any, step: Any) -> Any:
    """Return the distance by which a step with rates x' (n,) may cut an obstacle's corner [m], for CasADi.

    Between two positions at d_min from a corner, the path is a chord of the circle around the corner, whose midpoint is
    closer by (v dt)^2 / (8 d_min).
    """
    speed_squared = sum(rates[index] ** 2 for index in problem.positions)
    return speed_squared * step**2 / (8.0 * max(problem.clearance, _LEAST_CLEARANCE))


def stage_cost(problem: OptimalControlProblem, p: Any, u: Any, k: int) -> Any:
    """Return c(x_k, u_k) of Eq. 3.16 including the trap term, for arrays and for CasADi."""
    growth = problem.gamma ** (k + 1)
    goal = (p[0] - problem.goal[0]) ** 2 + (p[1] - problem.goal[1]) ** 2
    cost = growth * problem.state_weight * goal
    if problem.trap is not None and problem.trap_weight > 0.0:
        trap = (p[0] - problem.trap[0]) ** 2 + (p[1] - problem.trap[1]) ** 2
        cost -= growth * problem.trap_weight * trap
    return cost + problem.control_weight * sum(u[i] ** 2 for i in range(len(problem.system.controls)))


def trajectory_cost(problem: OptimalControlProblem, states: Array, controls: Array, time_step: float) -> float:
    """Return the cost of Eq. 3.16 of states (H+1, n) and controls (H, m)."""
    p = states[:-1, problem.positions]
    stages = [stage_cost(problem, p[k], u, k) for k, u in enumerate(controls)]
    return float(sum(stages)) * time_step / problem.time_step


def _controls(layout: Layout, free: Any) -> Any:
    """Return the full u of a stage: variables for free controls, numbers for fixed ones."""
    u = casadi.SX(layout.held)
    for index, control in enumerate(layout.free_controls.tolist()):
        u[control] = free[index]
    return u


def variable_bounds(layout: Layout, state_bounds: Array, terminal: Region) -> dict[str, Array]:
    """Return lbx and ubx; the start is only bounded by a constraint.

    Args:
        layout: Positions of states and controls in the vector of variables.
        state_bounds: Minimum and maximum states (2, n).
        terminal: Terminal set of x_H; its disc is a constraint.
    """
    problem, H = layout.problem, layout.problem.horizon
    out = {}
    for name, row in (("lbx", 0), ("ubx", 1)):
        states = np.tile(state_bounds[row], (H + 1, 1))
        for state, interval in terminal.intervals.items():
            index = problem.system.state_names.index(state)
            bound = (max, min)[row](states[H, index], interval[row])
            states[H, index] = bound
        states[0] = (-np.inf, np.inf)[row]
        controls = np.tile(problem.system.control_bounds[row], (H, 1))
        out[name] = layout.pack(states, controls, TIME_STEP_RANGE[row] * problem.time_step)
    return out


def _options(solver: SolverName, max_iterations: int, equality: list[bool]) -> dict[str, Any]:
    if solver == "fatrop":
        return {
            "structure_detection": "auto",
            "equality": equality,
            "fatrop": {"print_level": 0, "max_iter": max_iterations, "tol": 1e-6},
            "print_time": False,
            "show_eval_warnings": False,
        }
    return {
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": max_iterations, "tol": 1e-6},
        "print_time": False,
        "show_eval_warnings": False,
    }
