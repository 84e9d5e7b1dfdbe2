"""Sequential quadratic programming from a nearby trajectory, which needs few programs, unlike an interior point.

Each step solves the quadratic program at the current point (exact Hessian of the Lagrangian), stage by stage. From the
previous plan, one or two steps suffice: real-time iterations (Diehl, Bock, Schlöder, SIAM J. Control Optim. 43, 2005).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from oc_baseline_node.mpc.derivatives import Derivatives
from oc_baseline_node.mpc.stage_qp import solve_stages
from oc_baseline_node.mpc.transcription import NonlinearProgram

Array = NDArray[np.float64]
_DAMPING = (1e-4, 1e-2, 1.0)
"""Values to add to the Hessian's diagonal, tried in turn until the program has a minimum."""
_BEGINNINGS = ((1e-2, 1e-4), (1e-2, 1.0), (1.0, 1e2))
"""Initial values of the minimum slack and of the product of slack and multiplier; larger ones if stuck at a bound."""
_NEAR = 1.0
"""Distance beyond which a quadratic program omits an obstacle [m]; the trajectory is checked against all."""


_GAP = 1e-4
"""Tolerance of a program's complementarity, relative to the cost."""
_LEAST_GAP, _LARGEST_GAP = 1e-12, 1e-8
"""Range of the same tolerance per inequality, in the program's units."""


@dataclass(frozen=True)
class SqpStep:
    """Solution of a quadratic program.

    Attributes:
        variables: Variables of the program.
        multipliers: Multipliers of the constraints (M,), with CasADi's sign convention.
    """

    variables: Array
    multipliers: Array


class StageSqp:
    """Steps of sequential quadratic programming for one program.

    Args:
        program: Nonlinear program with variables in stage order.
        derivatives: Functions of the program's gradient, Jacobian and Hessian.
    """

    def __init__(self, program: NonlinearProgram, derivatives: Derivatives) -> None:
        layout = program.layout
        self._program = program
        self._n, self._w, self._K = layout.n + layout.free_time, layout.width, layout.problem.horizon
        self._start = program.kinds == "start"
        self._dynamics = program.kinds == "dynamics"
        self._unequal = ~self._start & ~self._dynamics
        stages = program.stages[self._unequal]
        # Position of each inequality within its stage: constraints are ordered by stage.
        self._place = np.arange(len(stages)) - np.searchsorted(stages, stages)
        self._rows = int(self._place.max(initial=-1)) + 1
        self._sign = np.where(program.kinds[self._unequal] == "disc", -1.0, 1.0)
        self._edge = np.where(program.kinds == "disc", program.bounds["ubg"], program.bounds["lbg"])[self._unequal]
        self._derivatives = derivatives
        self._index_jacobian()
        self._index_hessian()
        self._compile()

    def step(
        self, variables: Array, start: Array, bounds: dict[str, Array], multipliers: Array, least_damping: float = 0.0
    ) -> SqpStep | None:
        """Solve the quadratic program at a point; return None if it has no solution.

        Args:
            variables: Variables of the program at the point.
            start: Start state x_0 (n,).
            bounds: Bounds of the variables, lbx and ubx.
            multipliers: Multipliers of the constraints at the point (M,); zeros omit the constraints' curvature.
            least_damping: Minimum value to add to the Hessian's diagonal; larger values shorten the step.
        """
        K, n, w = self._K, self._n, self._w
        g, jacobian = self._derivatives.jacobian(variables, start)
        (gradient,) = self._derivatives.gradient(variables, start)
        if not all(np.isfinite(each).all() for each in (g, jacobian, gradient)):
            return None
        A, G = np.zeros((K, n, w)), np.zeros((K + 1, self._rows, w))
        A.ravel()[self._A[1]] = -jacobian[self._A[0]]
        G.ravel()[self._G[1]] = jacobian[self._G[0]] * self._G[2]
        c = np.full((K + 1, self._rows), np.inf)
        at = (g[self._unequal] - self._edge) * self._sign
        c[self._program.stages[self._unequal], self._place] = np.where(at < _NEAR, at, np.inf)
        q = self._by_stages(gradient, 0.0)
        lower = self._by_stages(bounds["lbx"] - variables, -np.inf)
        upper = self._by_stages(bounds["ubx"] - variables, np.inf)
        rest = (q, A, -g[self._dynamics].reshape(K, n), lower, upper, G, c, -g[self._start])
        for each in (multipliers, np.zeros(len(g))) if multipliers.any() else (multipliers,):
            found = self._solve(variables, start, each, rest, least_damping)
            if found is not None:
                z, weights, gradients = found
                new = np.zeros(len(g))
                new[self._dynamics] = -gradients[1:].ravel()
                new[self._unequal] = -self._sign * weights[self._program.stages[self._unequal], self._place]
                return SqpStep(variables + z.ravel()[: len(variables)], new)
        return None

    def _solve(
        self, variables: Array, start: Array, multipliers: Array, rest: tuple[Array, ...], least: float
    ) -> tuple[Array, Array, Array] | None:
        """Return z, multipliers and gradients for the Hessian with these multipliers, or None."""
        (entries,) = self._derivatives.hessian(variables, start, np.ones(1), multipliers)
        if not np.isfinite(entries).all():
            return None
        H = np.zeros((self._K + 1, self._w, self._w))
        H.ravel()[self._H[1]] = entries[self._H[0]]
        cost = abs(float(self._derivatives.cost(variables, start)[0][0]))
        gap = float(np.clip(_GAP * cost / rest[0].size, _LEAST_GAP, _LARGEST_GAP))
        for damping, beginning in product([least, *(each for each in _DAMPING if each > least)], _BEGINNINGS):
            count, *found = solve_stages(H, *rest, damping, gap, *beginning)
            if count > 0:
                return found[0], found[1], found[2]
            if count == 0 and beginning == _BEGINNINGS[-1]:  # damping cannot make a program feasible
                return None
        return None

    def shift(self, multipliers: Array, steps: int) -> Array:
        """Return the multipliers (M,) of a trajectory shifted by `steps`, as `shift_trajectory` does for states."""
        out, gamma = np.zeros_like(multipliers), self._program.layout.problem.gamma
        for which in (self._dynamics, self._unequal & (self._program.kinds == "obstacle")):
            table = multipliers[which].reshape(self._K, -1)
            out[which] = table[np.minimum(np.arange(self._K) + steps, self._K - 1)].ravel()
        disc = self._program.kinds == "disc"
        out[disc] = multipliers[disc]
        return out / gamma**steps

    def _compile(self) -> None:
        """Compile the recursion, or load it from the cache, before the first solve."""
        empty = np.zeros((2, 1)), np.zeros((1, 1, 2)), np.zeros((2, 2)), np.zeros((2, 0, 2)), np.zeros((2, 0))
        H = np.stack((np.eye(2), np.eye(2)))
        solve_stages(
            H, empty[2], empty[1], empty[0][:1], empty[2], empty[2], empty[3], empty[4], np.ones(1), 0.0, 1.0, 1.0, 1.0
        )

    def _by_stages(self, flat: Array, rest: float) -> Array:
        out = np.full((self._K + 1) * self._w, rest)
        out[: len(flat)] = flat
        return out.reshape(self._K + 1, self._w)

    def _index_jacobian(self) -> None:
        """Record which entries of the sparse Jacobian belong to A and to G, and their positions."""
        row, column = self._derivatives.jacobian.rows, self._derivatives.jacobian.columns
        program, w = self._program, self._w
        stage, local = column // w, column % w
        mine = np.flatnonzero(self._dynamics[row] & (stage == program.stages[row]))
        order = np.cumsum(self._dynamics) - 1
        self._A = mine, order[row[mine]] * w + local[mine]
        mine = np.flatnonzero(self._unequal[row])
        order = np.cumsum(self._unequal) - 1
        inequality = order[row[mine]]
        self._G = (
            mine,
            (program.stages[row[mine]] * self._rows + self._place[inequality]) * w + local[mine],
            self._sign[inequality],
        )

    def _index_hessian(self) -> None:
        row, column = self._derivatives.hessian.rows, self._derivatives.hessian.columns
        entries = np.arange(len(row))
        lone = row != column if (row <= column).all() else np.zeros(len(row), dtype=bool)  # ipopt: upper triangle
        row, column = np.concatenate((row, column[lone])), np.concatenate((column, row[lone]))
        entries = np.concatenate((entries, entries[lone]))
        w = self._w
        self._H = entries, (row // w * w + row % w) * w + column % w
