"""MPC: trajectories of the optimal control problem, and a receding-horizon controller (thesis Eq. 3.16)."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import signed_distance
from oc_baseline_node.mpc.initial_guess import InitialGuesses, equilibrium_control, shift_trajectory
from oc_baseline_node.mpc.transcription import NonlinearProgram, SolverName, trajectory_cost, transcribe
from oc_baseline_node.problems.problem import OptimalControlProblem

Array = NDArray[np.float64]
_CHECKED_FRACTIONS = (0.25, 0.5, 0.75)
"""Fractions of a step at which the clearance is checked."""
TOLERANCE = 1e-4
"""Largest violation of a constraint by a solved trajectory [m, rad, ...]."""


@dataclass(frozen=True)
class MpcSolution:
    """Result of the solvers for one start.

    Attributes:
        states: States x_0 .. x_H (H+1, n); not to be used where not `solved`.
        controls: Controls u_0 .. u_{H-1} (H, m).
        time_step: Duration of a step [s].
        solved: Whether the trajectory keeps every constraint.
        reason: Status of the last solver (CasADi's return_status), or why no solver was asked.
        cost: Cost of Eq. 3.16, NaN where not solved.
        iterations: Number of iterations of all solvers asked.
        cpu_seconds: Processor time of all solvers asked [s], without setting up their programs.
    """

    states: Array
    controls: Array
    time_step: float
    solved: bool
    reason: str
    cost: float
    iterations: int
    cpu_seconds: float


_SIMPLIFICATIONS = ("", " (with the least control alone)", " (with a state cost that does not grow)")


class Mpc:
    """Solves one problem from any start; the programs are set up once.

    Where that fails and obstacles are in the way it goes by steps: first with the least control alone, then with a
    state cost that does not grow, then the problem itself. Over hundreds of steps the growth of the state cost leaves
    a solver nothing to hold on to at the beginning.

    Args:
        problem: Optimal control problem to solve.
        solvers: Solvers, asked in this order with each guess until one succeeds; fatrop is faster, ipopt more robust.
        max_iterations: Largest number of iterations of each solver.
    """

    def __init__(
        self,
        problem: OptimalControlProblem,
        solvers: tuple[SolverName, ...] = ("fatrop", "ipopt"),
        max_iterations: int = 300,
    ) -> None:
        self.problem = problem
        self._solvers = solvers
        self._max_iterations = max_iterations
        level = replace(problem, gamma=1.0)
        self._problems = (problem, replace(level, state_weight=0.0, trap_weight=0.0), level)
        self._programs: dict[tuple[int, SolverName], NonlinearProgram] = {}
        self._guesses = InitialGuesses(problem)

    def solve(
        self, start: ArrayLike, guess: tuple[Array, Array] | None = None, check_start: bool = True
    ) -> MpcSolution:
        """Return the trajectory from `start` (n,).

        Args:
            start: Start state x_0 (n,).
            guess: States (H+1, n) and controls (H, m) to begin with, such as a trajectory nearby (a warm start).
            check_start: Whether a start that breaks the constraints is refused without asking a solver.
        """
        start = np.asarray(start, dtype=float)
        refusal = self.problem.refusal(start) if check_start else ""
        if refusal:
            return _unsolved(self.problem, start, refusal)
        guesses = self._guesses(start) if guess is None else [guess]
        tries: list[MpcSolution] = []
        for name, each in product(self._solvers, guesses):
            tries.append(self._attempt(0, name, start, *each))
            if tries[-1].solved:
                break
        else:
            if len(guesses) > 1:  # the straight line runs through an obstacle
                tries.extend(self._solve_by_continuation(start, guesses[0]))
        # The last of the steps that was solved; without any the reason is that of the problem itself.
        best = next((each for each in reversed(tries) if each.solved), tries[-1])
        iterations, seconds = sum(each.iterations for each in tries), sum(each.cpu_seconds for each in tries)
        return replace(best, iterations=iterations, cpu_seconds=seconds)

    def _solve_by_continuation(self, start: Array, guess: tuple[Array, Array]) -> list[MpcSolution]:
        """Return trajectories of easier problems up to the problem itself, each begun with the one before.

        The last that is solved keeps every constraint, though its objective may be an easier one, as its reason says.
        """
        name, found = self._solvers[0], []
        for rung in range(1, len(self._problems) + 1):
            trajectory = self._attempt(rung % len(self._problems), name, start, *guess)
            if not trajectory.solved:
                break
            found.append(trajectory)
            guess = (trajectory.states, trajectory.controls)
        return found

    def _attempt(self, rung: int, name: SolverName, start: Array, states: Array, controls: Array) -> MpcSolution:
        """Return the result of one solver for one of the problems."""
        program = self._program(rung, name)
        begin = time.process_time()
        variables = program.layout.pack(states, controls, self.problem.time_step)
        answer = program.solver(x0=variables, p=start, **program.bounds)
        stats = program.solver.stats()
        seconds, iterations = time.process_time() - begin, int(stats["iter_count"])
        reason = _reason(name, stats) + _SIMPLIFICATIONS[rung]
        if not stats["success"]:
            return _unsolved(self.problem, start, reason, iterations, seconds)
        states, controls, time_step = program.layout.unpack(np.asarray(answer["x"]).ravel())
        broken = self._violated_constraint(start, states, controls, time_step)
        if broken:
            return _unsolved(self.problem, start, broken, iterations, seconds)
        cost = trajectory_cost(self.problem, states, controls, time_step)
        return MpcSolution(states, controls, time_step, True, reason, cost, iterations, seconds)

    def _program(self, rung: int, name: SolverName) -> NonlinearProgram:
        if (rung, name) not in self._programs:
            self._programs[rung, name] = transcribe(self._problems[rung], name, self._max_iterations)
        return self._programs[rung, name]

    def _violated_constraint(self, start: Array, states: Array, controls: Array, time_step: float) -> str:
        """Say which constraint a trajectory misses by more than the tolerance, checked against the real boxes."""
        problem = self.problem
        low, high = problem.state_bounds
        u_low, u_high = problem.system.control_bounds
        steps = problem.system.step(states[:-1], controls, dt=time_step)
        checks = {
            "start": np.abs(states[0] - start).max(),
            "dynamics": np.abs(states[1:] - steps).max(),
            "clearance": -problem.margin(states[1:]).min(),
            "clearance between samples": problem.clearance
            - _clearance_between_samples(problem, states, controls, time_step),
            "state bounds": max((low - states[1:]).max(), (states[1:] - high).max()),
            "control bounds": max((u_low - controls).max(), (controls - u_high).max()),
            "terminal set": problem.terminal_violation(states[-1]),
        }
        for name, violation in checks.items():
            if not violation <= TOLERANCE:
                return f"solution misses {name} by {violation:.2g}"
        return ""


def _clearance_between_samples(
    problem: OptimalControlProblem, states: Array, controls: Array, time_step: float
) -> float:
    """Return how near a trajectory comes to an obstacle between its samples [m], but for the step from the start.

    The start may lie at d_min, from where a step leads nearer to a corner before it leads away.
    """
    if not problem.obstacles:
        return np.inf
    between = [problem.system.step(states[1:-1], controls[1:], dt=part * time_step) for part in _CHECKED_FRACTIONS]
    return float(signed_distance(problem.obstacles, np.array(between)[..., problem.positions]).min())


class RecedingHorizon:
    """A controller: solves anew from each state, begins with what it planned before, applies the first control.

    Where no solver finds a trajectory it carries on with the plan that it has.

    Attributes:
        plan: Last solved trajectory, None before the first.
        reason: Status of the last solver; not a success where `plan` is an older one.
    """

    def __init__(self, mpc: Mpc) -> None:
        self._mpc = mpc
        self._rest = equilibrium_control(mpc.problem.system)
        self._age = 0
        self.plan: MpcSolution | None = None
        self.reason = ""
        self.solved = False

    def control(self, state: ArrayLike) -> Array:
        """Return u (m,) for a state (n,); call it once each time step."""
        self._age += 1
        guess = None if self.plan is None else shift_trajectory(self.plan.states, self.plan.controls, self._age)
        trajectory = self._mpc.solve(state, guess, check_start=False)
        if not trajectory.solved and guess is not None:
            trajectory = self._mpc.solve(state, check_start=False)
        self.solved, self.reason = trajectory.solved, trajectory.reason
        if trajectory.solved:
            self.plan, self._age = trajectory, 0
        if self.plan is None or self._age >= len(self.plan.controls):
            return self._rest.copy()
        return self.plan.controls[self._age].copy()


def _reason(name: SolverName, stats: dict[str, Any]) -> str:
    """Return the solver's own words; fatrop has numbers only, so CasADi's general word is added."""
    status = str(stats["return_status"])
    if name == "fatrop":
        status = str(stats.get("unified_return_status", status)).removeprefix("SOLVER_RET_")
    return f"{name}: {status}"


def _unsolved(
    problem: OptimalControlProblem, start: Array, reason: str, iterations: int = 0, seconds: float = 0.0
) -> MpcSolution:
    states = np.full((problem.horizon + 1, len(problem.system.states)), np.nan)
    states[0] = start if start.shape == states[0].shape else np.nan
    controls = np.full((problem.horizon, len(problem.system.controls)), np.nan)
    return MpcSolution(states, controls, problem.time_step, False, reason, float("nan"), iterations, seconds)
