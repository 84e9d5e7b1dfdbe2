"""Receding-horizon control: a controller that re-solves at every state, starting from its previous plan."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oc_baseline_node.mpc.initial_guess import equilibrium_control, shift_trajectory
from oc_baseline_node.mpc.mpc import Mpc
from oc_baseline_node.mpc.solution import MpcSolution

Array = NDArray[np.float64]


class RecedingHorizon:
    """Re-solves at every state, starting from its previous plan, and applies the first control.

    If no solver finds a trajectory, the previous plan is continued.

    Attributes:
        plan: Last solved trajectory; None before the first.
        reason: Status of the last solver; a failure if `plan` is older.
        solved: Whether a trajectory was found for the last state.
        spent: CPU time of the solvers for the last state [s].
    """

    def __init__(self, mpc: Mpc) -> None:
        self._mpc = mpc
        self._rest = equilibrium_control(mpc.problem.system)
        self._age = 0
        self.plan: MpcSolution | None = None
        self.reason = ""
        self.solved = False
        self.spent = 0.0

    def control(self, state: ArrayLike) -> Array:
        """Return the control u (m,) for a state (n,); call once per time step."""
        self._age += 1
        tries = [] if self.plan is None else [self._solve_nearby(state, self.plan)]
        if not tries or not tries[-1].solved:
            tries.append(self._mpc.solve(state, check_start=False))
        trajectory, self.spent = tries[-1], sum(each.cpu_seconds for each in tries)
        self.solved, self.reason = trajectory.solved, trajectory.reason
        if trajectory.solved:
            self.plan, self._age = trajectory, 0
        if self.plan is None or self._age >= len(self.plan.controls):
            return self._rest.copy()
        return self.plan.controls[self._age].copy()

    def _solve_nearby(self, state: ArrayLike, plan: MpcSolution) -> MpcSolution:
        guess = shift_trajectory(plan.states, plan.controls, self._age)
        return self._mpc.solve(state, guess, False, self._mpc.shift(plan.multipliers, self._age))
