"""Solving a problem: whole trajectories, and a controller with a receding horizon (thesis Eq. 3.16)."""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oc_baseline_node.guesses import Guesses, moved_on, resting_control
from oc_baseline_node.problem import Problem
from oc_baseline_node.transcription import Program, SolverName, transcribe

Array = NDArray[np.float64]
TOLERANCE = 1e-4
"""By how much a solved trajectory may miss a constraint [m, rad, ...]."""


@dataclass(frozen=True)
class Trajectory:
    """What a solver made of a start.

    Attributes:
        states: x_0 .. x_H (H+1, n); not to be used where not `solved`.
        controls: u_0 .. u_{H-1} (H, m).
        time_step: [s].
        solved: whether it keeps every constraint.
        reason: the solver's last word (CasADi's return_status), or why no solver was asked.
        cost: Eq. 3.16, NaN where not solved.
        iterations: of all solvers asked.
        cpu_seconds: they took, without setting up their programs.
    """

    states: Array
    controls: Array
    time_step: float
    solved: bool
    reason: str
    cost: float
    iterations: int
    cpu_seconds: float


class Mpc:
    """Solves one problem from any start; the programs are set up once.

    Args:
        problem: to solve.
        solvers: asked in this order, with each guess, until one succeeds; fatrop is the faster, ipopt the more robust.
        max_iterations: of each.
    """

    def __init__(
        self, problem: Problem, solvers: tuple[SolverName, ...] = ("fatrop", "ipopt"), max_iterations: int = 300
    ) -> None:
        self.problem = problem
        self._solvers = solvers
        self._max_iterations = max_iterations
        self._programs: dict[SolverName, Program] = {}
        self._guesses = Guesses(problem)

    def solve(self, start: ArrayLike, guess: tuple[Array, Array] | None = None, check_start: bool = True) -> Trajectory:
        """Return the trajectory from `start` (n,).

        Args:
            start: x_0.
            guess: states (H+1, n) and controls (H, m) to begin with, e.g. of a trajectory nearby (a warm start).
            check_start: whether a start that breaks the constraints is refused without asking a solver.
        """
        start = np.asarray(start, dtype=float)
        refusal = self.problem.refusal(start) if check_start else ""
        if refusal:
            return _unsolved(self.problem, start, refusal)
        iterations, seconds = 0, 0.0
        guesses = self._guesses(start) if guess is None else [guess]
        for name, (states, controls) in product(self._solvers, guesses):
            program = self._program(name)
            begin = time.process_time()
            variables = program.layout.pack(states, controls, self.problem.time_step)
            answer = program.solver(x0=variables, p=start, **program.bounds)
            stats = program.solver.stats()
            seconds += time.process_time() - begin
            iterations += int(stats["iter_count"])
            reason = _reason(name, stats)
            if stats["success"]:
                states, controls, time_step = program.layout.unpack(np.asarray(answer["x"]).ravel())
                reason = self._broken(start, states, controls, time_step)
                if not reason:
                    cost = float(answer["f"]) / program.cost_scale
                    return Trajectory(
                        states, controls, time_step, True, _reason(name, stats), cost, iterations, seconds
                    )
        return _unsolved(self.problem, start, reason, iterations, seconds)

    def _program(self, name: SolverName) -> Program:
        if name not in self._programs:
            self._programs[name] = transcribe(self.problem, name, self._max_iterations)
        return self._programs[name]

    def _broken(self, start: Array, states: Array, controls: Array, time_step: float) -> str:
        """Say which constraint a trajectory misses by more than the tolerance, checked against the real boxes."""
        problem = self.problem
        low, high = problem.state_bounds
        u_low, u_high = problem.system.control_bounds
        steps = problem.system.step(states[:-1], controls, dt=time_step)
        checks = {
            "start": np.abs(states[0] - start).max(),
            "dynamics": np.abs(states[1:] - steps).max(),
            "clearance": -problem.margin(states[1:]).min(),
            "state bounds": max((low - states[1:]).max(), (states[1:] - high).max()),
            "control bounds": max((u_low - controls).max(), (controls - u_high).max()),
            "terminal set": problem.terminal_violation(states[-1]),
        }
        for name, violation in checks.items():
            if not violation <= TOLERANCE:
                return f"solution misses {name} by {violation:.2g}"
        return ""


class RecedingHorizon:
    """A controller: solves anew from each state, begins with what it planned before, applies the first control.

    Where no solver finds a trajectory it carries on with the plan that it has.

    Attributes:
        plan: the last solved trajectory, None before the first.
        reason: the last solver's word; differs from success where `plan` is an older one.
    """

    def __init__(self, mpc: Mpc) -> None:
        self._mpc = mpc
        self._rest = resting_control(mpc.problem.system)
        self._age = 0
        self.plan: Trajectory | None = None
        self.reason = ""
        self.solved = False

    def control(self, state: ArrayLike) -> Array:
        """Return u (m,) for a state (n,); call it once each time step."""
        self._age += 1
        guess = None if self.plan is None else moved_on(self.plan.states, self.plan.controls, self._age)
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


def _unsolved(problem: Problem, start: Array, reason: str, iterations: int = 0, seconds: float = 0.0) -> Trajectory:
    states = np.full((problem.horizon + 1, len(problem.system.states)), np.nan)
    states[0] = start if start.shape == states[0].shape else np.nan
    controls = np.full((problem.horizon, len(problem.system.controls)), np.nan)
    return Trajectory(states, controls, problem.time_step, False, reason, float("nan"), iterations, seconds)
