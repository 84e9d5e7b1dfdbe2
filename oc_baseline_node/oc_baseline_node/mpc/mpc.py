"""MPC: solves the optimal control problem (thesis Eq. 3.16) from scratch or from a nearby trajectory."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import Region
from oc_baseline_node.errors import OcError
from oc_baseline_node.mpc.derivatives import Derivatives, singular_derivative, undefined_start
from oc_baseline_node.mpc.initial_guess import InitialGuesses
from oc_baseline_node.mpc.limited import LimitedSolver
from oc_baseline_node.mpc.solution import MpcSolution, checked, unsolved
from oc_baseline_node.mpc.sqp import StageSqp
from oc_baseline_node.mpc.transcription import SolverName, model_rates, trajectory_cost, transcribe, variable_bounds
from oc_baseline_node.problems.coordinates import nearest_turn
from oc_baseline_node.problems.problem import OptimalControlProblem

Array = NDArray[np.float64]
Guess = tuple[Array, Array]
_SIMPLIFICATIONS = ("", " (with the least control alone)", " (with a state cost that does not grow)")
_NUDGES = (1e-6, 1e-4, 1e-2, 1e-1)
"""Relative and absolute distances by which a guess is moved if a derivative is not finite."""
_FATROP_SHARE = 0.25
"""Fraction of the time limit after which fatrop is terminated, to leave time for ipopt."""
_FAR = 0.25
"""Fraction of a period from which the other direction may be cheaper because of the other states."""
_DAMPINGS = (0.0, 0.0, 1e-2, 1e-1, 1.0, 1.0)
"""Damping values of each quadratic program from a nearby trajectory: full steps first, then shorter ones."""
_SETTLED = 0.1
"""Relative change of the cost below which the next quadratic program would change it by less than a hundredth."""


class Mpc:
    """Solves one problem from any start; the programs are set up once.

    From a nearby trajectory, a few quadratic programs suffice; otherwise an interior-point solver is used. If that
    fails and obstacles are in the way, the problem is solved by continuation: first with control cost only, then with a
    constant state cost, then the problem itself. Over hundreds of steps, the growing state cost makes the first stages
    negligible for a solver.

    Args:
        problem: Optimal control problem to solve.
        solvers: Solvers, tried in this order with each guess until one succeeds; fatrop is faster, ipopt more robust.
            If the model has corners and both are given, only ipopt is used, because fatrop may not terminate.
        max_iterations: Maximum number of iterations of each solver.
        time_limit: CPU time limit per start [s]; a solver that exceeds it (fatrop: a quarter of it) is terminated.
        nearby: Whether to start from a given trajectory with quadratic programs; otherwise an interior-point solver
            starts there.

    Raises:
        OcError: The time limit is not positive.
    """

    def __init__(
        self,
        problem: OptimalControlProblem,
        solvers: tuple[SolverName, ...] = ("fatrop", "ipopt"),
        max_iterations: int = 300,
        time_limit: float = 40.0,
        nearby: bool = True,
    ) -> None:
        if not 0.0 < time_limit < np.inf:
            raise OcError(f"the time limit is {time_limit:g} s: give a positive number of seconds")
        self.problem = problem
        self._solvers = solvers
        self._max_iterations = max_iterations
        self._time_limit = time_limit
        self._nearby = nearby
        level = replace(problem, gamma=1.0)
        self._problems = (problem, replace(level, state_weight=0.0, trap_weight=0.0), level)
        self._tools: dict[tuple[int, SolverName], _Tool] = {}
        self._guesses = InitialGuesses(problem)

    @cached_property
    def rounded(self) -> tuple[str, ...]:
        """Operations of the model that were smoothed for the solvers, because they are not always differentiable."""
        return model_rates(self.problem)[1]

    @cached_property
    def _asked(self) -> tuple[SolverName, ...]:
        """Solvers, in the order in which they are tried."""
        return ("ipopt",) if "ipopt" in self._solvers and self.rounded else self._solvers

    def solve(
        self,
        start: ArrayLike,
        guess: Guess | None = None,
        check_start: bool = True,
        multipliers: Array | None = None,
    ) -> MpcSolution:
        """Return the trajectory from `start` (n,).

        Args:
            start: Start state x_0 (n,).
            guess: Initial states (H+1, n) and controls (H, m), such as a nearby trajectory (a warm start).
            check_start: Whether to reject a start that violates the constraints without calling a solver.
            multipliers: Multipliers of the constraints for the guess (M,), if known.
        """
        start = np.asarray(start, dtype=float)
        refusal = (self.problem.refusal(start) if check_start else "") or undefined_start(self.problem, start)
        if refusal:
            return unsolved(self.problem, start, refusal)
        tries: list[MpcSolution] = []
        if guess is not None:
            guess = self._beside(start, guess)
        if guess is not None and self._nearby:
            tries.append(self._solve_nearby(start, guess, multipliers))
            if tries[-1].solved:
                return tries[-1]
        guesses = self._guesses(start) if guess is None else [guess]
        bounds = self.problem.bounds_around(start)
        toward = start if guess is None else guess[0][-1]
        found: list[MpcSolution] = []
        nearest = 0.0
        for distance, way in self.problem.ways_round(toward, bounds):
            nearest = nearest if found else distance
            if nearest < _FAR and any(each.solved for each in found):
                break
            found.append(self._solve_way(way, start, bounds, guesses, tries))
        solved = [each for each in found if each.solved]
        best = min(solved, key=lambda each: each.cost) if solved else found[0]
        iterations, seconds = sum(each.iterations for each in tries), sum(each.cpu_seconds for each in tries)
        cause = "" if best.solved or not self.rounded else singular_derivative(self.problem, start)
        reason = f"{best.reason}; {cause}" if cause else best.reason
        return replace(best, reason=reason, iterations=iterations, cpu_seconds=seconds)

    def shift(self, multipliers: Array, steps: int) -> Array | None:
        """Return multipliers (M,) for a trajectory shifted by `steps`; None if unknown."""
        return self._tool(0, self._asked[0]).sqp.shift(multipliers, steps) if len(multipliers) else None

    def _solve_way(
        self, terminal: Region, start: Array, bounds: Array, guesses: list[Guess], tries: list[MpcSolution]
    ) -> MpcSolution:
        """Return the trajectory that ends in one copy of the terminal set, with totals over all attempts."""
        mine: list[MpcSolution] = []
        for name, guess in product(self._asked, guesses):
            mine.append(self._attempt(0, name, start, guess, bounds, terminal, tries))
            if mine[-1].solved:
                break
        else:
            if len(guesses) > 1:  # the straight line passes through an obstacle
                mine += self._solve_by_continuation(start, guesses[0], bounds, terminal, tries)
        # The last step solved; if none was, the reason is that of the problem itself.
        return next((each for each in reversed(mine) if each.solved), mine[-1])

    def _solve_by_continuation(
        self, start: Array, guess: Guess, bounds: Array, terminal: Region, tries: list[MpcSolution]
    ) -> list[MpcSolution]:
        """Solve easier problems up to the problem itself, each starting from the previous solution.

        The last solution satisfies every constraint, but its objective may be an easier one, as stated in `reason`.
        """
        name, found = self._asked[0], []
        for rung in range(1, len(self._problems) + 1):
            trajectory = self._attempt(rung % len(self._problems), name, start, guess, bounds, terminal, tries)
            if not trajectory.solved:
                break
            found.append(trajectory)
            guess = (trajectory.states, trajectory.controls)
        return found

    def _attempt(
        self,
        rung: int,
        name: SolverName,
        start: Array,
        guess: Guess,
        bounds: Array,
        terminal: Region,
        tries: list[MpcSolution],
    ) -> MpcSolution:
        """Run one solver on one of the problems; append the result to `tries` and return it."""
        tool, problem = self._tool(rung, name), self.problem
        left = self._time_limit - sum(each.cpu_seconds for each in tries)
        share = min(left, _FATROP_SHARE * self._time_limit) if name == "fatrop" and "ipopt" in self._asked else left
        variables = tool.program.layout.pack(*guess, problem.time_step)
        variables, trouble = tool.beside_trouble(variables, start)
        if left <= 0.0 or trouble:
            reason = trouble or f"no trajectory within {self._time_limit:g} CPU s"
            tries.append(unsolved(problem, start, reason))
            return tries[-1]
        arguments = {"x0": variables, "p": start, **tool.program.bounds}
        answer = tool.solver(arguments | variable_bounds(tool.program.layout, bounds, terminal), share)
        if answer is None:
            tries.append(unsolved(problem, start, f"{name}: ended after {share:.3g} CPU s", seconds=share))
        elif answer.success:
            trajectory = tool.program.layout.unpack(answer.variables)
            reason = f"{name}: {answer.status}{_SIMPLIFICATIONS[rung]}"
            multipliers = answer.multipliers if rung == 0 else np.empty(0)
            spent = (answer.iterations, answer.seconds)
            tries.append(checked(problem, start, trajectory, reason, *spent, multipliers))
        else:
            said = f"{name}: {answer.status}{_SIMPLIFICATIONS[rung]}"
            where = tool.derivatives.trouble(answer.variables, start) if "Invalid" in answer.status else ""
            reason = f"{said}: {where}" if where else said
            tries.append(unsolved(problem, start, reason, answer.iterations, answer.seconds))
        return tries[-1]

    def _solve_nearby(self, start: Array, guess: Guess, multipliers: Array | None) -> MpcSolution:
        """Solve a few quadratic programs from a nearby trajectory."""
        problem, tool = self.problem, self._tool(0, self._asked[0])
        layout, sqp = tool.program.layout, tool.sqp
        begin = time.process_time()
        bounds = problem.bounds_around(start)
        limits = variable_bounds(layout, bounds, problem.ways_round(guess[0][-1], bounds)[0][1])
        variables = layout.pack(*guess, problem.time_step)
        if multipliers is None:
            multipliers = np.zeros(len(tool.program.kinds))
        cost, found = trajectory_cost(problem, *guess, problem.time_step), unsolved(problem, start, "sqp: no minimum")
        for count, damping in enumerate(_DAMPINGS, 1):
            step = sqp.step(variables, start, limits, multipliers, damping)
            if step is None:
                break
            variables, multipliers = step.variables, step.multipliers
            found = checked(problem, start, layout.unpack(variables), "sqp: solved", count, 0.0, multipliers)
            if found.solved and abs(found.cost - cost) <= _SETTLED * abs(found.cost):
                return replace(found, cpu_seconds=time.process_time() - begin)
            cost = found.cost
        reason = "sqp: not settled" if found.solved else found.reason
        return unsolved(problem, start, reason, found.iterations, time.process_time() - begin)

    def _beside(self, start: Array, guess: Guess) -> Guess:
        """Shift a guess's angular states by whole periods, so that the guess starts next to the start state."""
        states, controls = guess
        turn = nearest_turn(states[0], start, self.problem.periods) - states[0]
        return states + turn, controls

    def _tool(self, rung: int, name: SolverName) -> _Tool:
        if (rung, name) not in self._tools:
            self._tools[rung, name] = _Tool(self._problems[rung], name, self._max_iterations)
        return self._tools[rung, name]


class _Tool:
    """A problem's program with its solver, derivatives and quadratic programs."""

    def __init__(self, problem: OptimalControlProblem, name: SolverName, max_iterations: int) -> None:
        self.program = transcribe(problem, name, max_iterations)
        self.solver = LimitedSolver(self.program.solver)
        self.derivatives = Derivatives(self.program)

    @cached_property
    def sqp(self) -> StageSqp:
        return StageSqp(self.program, self.derivatives)

    def beside_trouble(self, variables: Array, start: Array) -> tuple[Array, str]:
        """Return variables moved away from undefined derivatives; if all attempts fail, name the derivative.

        A solver that starts there cannot take a step, and fatrop does not terminate.
        """
        trouble = self.derivatives.trouble(variables, start)
        if not trouble:
            return variables, ""
        random = np.random.default_rng(0)
        for size in _NUDGES:
            moved = variables + size * (1.0 + np.abs(variables)) * random.uniform(-1.0, 1.0, len(variables))
            if not self.derivatives.trouble(moved, start):
                return moved, ""
        return variables, trouble
