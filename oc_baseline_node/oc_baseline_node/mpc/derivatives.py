"""Values and derivatives of a nonlinear program as arrays, with checks that they are finite."""

from __future__ import annotations

from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from oc_baseline_node.mpc.transcription import NonlinearProgram
from oc_baseline_node.problems.problem import OptimalControlProblem

Array = NDArray[np.float64]


class Compiled:
    """A CasADi function that writes its results to arrays without copying.

    Args:
        function: Function of dense arguments.
        wanted: Outputs to compute.

    Attributes:
        rows: Row of each entry of the last wanted output (E,).
        columns: Column of each entry of the last wanted output (E,).
    """

    def __init__(self, function: Any, *wanted: int) -> None:
        self._buffer, self._run = function.buffer()
        self._in = [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
        self._out = [np.zeros(function.nnz_out(i)) for i in wanted]
        for i, array in enumerate(self._in):
            self._buffer.set_arg(i, memoryview(array.data))
        for i, array in zip(wanted, self._out, strict=True):
            self._buffer.set_res(i, memoryview(array.data))
        rows, columns = function.sparsity_out(wanted[-1]).get_triplet()
        self.rows, self.columns = np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp)

    def __call__(self, *arguments: Array) -> list[Array]:
        """Return the wanted outputs' entries, valid until the next call."""
        for place, given in zip(self._in, arguments, strict=True):
            place[:] = given
        self._run()
        return self._out


class Derivatives:
    """Derivatives of a program, from its solver's functions.

    Attributes:
        cost: Cost (variables, start).
        gradient: Gradient of the cost (variables, start).
        jacobian: Constraints and their Jacobian (variables, start).
        hessian: Hessian of the Lagrangian (variables, start, 1, multipliers).
    """

    def __init__(self, program: NonlinearProgram) -> None:
        self._program = program
        self.cost = Compiled(program.solver.get_function("nlp_f"), 0)
        self.gradient = Compiled(program.solver.get_function("nlp_grad_f"), 0)
        self.jacobian = Compiled(program.solver.get_function("nlp_jac_g"), 0, 1)
        hessian = program.solver.get_function("nlp_hess_l")  # fatrop's output has the gradient first
        self.hessian = Compiled(hessian, hessian.n_out() - 1)

    def trouble(self, variables: Array, start: Array) -> str:
        """Describe a non-finite value or derivative at a point; empty if there is none."""
        g, jacobian = self.jacobian(variables, start)
        (gradient,) = self.gradient(variables, start)
        (hessian,) = self.hessian(variables, start, np.ones(1), np.ones(len(g)))
        rows, columns = self.jacobian.rows, self.jacobian.columns
        for array, row, column in (
            (g, range(len(g)), None),
            (jacobian, rows, columns),
            (gradient, None, range(len(gradient))),
            (hessian, None, self.hessian.columns),
        ):
            wrong = np.flatnonzero(~np.isfinite(array))
            if len(wrong):
                first = wrong[0]
                return self._words(
                    float(array[first]),
                    None if row is None else int(row[first]),
                    None if column is None else int(column[first]),
                    second=array is hessian,
                )
        return ""

    def _words(self, value: float, row: int | None, column: int | None, second: bool) -> str:
        """Describe the non-finite quantity: a constraint's value, or the derivative of a constraint or the cost."""
        of = "the cost" if row is None else self._constraint(row)
        if second:
            of = "the Lagrangian"
        if column is None:
            return f"{of} is {value:g}"
        order = "second derivative" if second else "derivative"
        return f"the {order} of {of} by {self._variable(column)} is {value:g}"

    def _constraint(self, row: int) -> str:
        program, names = self._program, self._program.layout.problem.system.state_names
        k, kind = int(program.stages[row]), str(program.kinds[row])
        place = row - int(np.flatnonzero((program.stages == k) & (program.kinds == kind))[0])
        if kind == "dynamics":
            return f"{names[place] if place < len(names) else 'time step'} at step {k + 1}"
        return f"the {kind} constraint at step {k}"

    def _variable(self, column: int) -> str:
        layout = self._program.layout
        system = layout.problem.system
        k, place = divmod(column, layout.width)
        names = [*system.state_names, *(["time step"] if layout.free_time else [])]
        names += [system.control_names[index] for index in layout.free_controls]
        return f"{names[place]} at step {k}"


def undefined_start(problem: OptimalControlProblem, start: Array) -> str:
    """Describe a rate of the model that is undefined at a start (n,) for any control; empty if there is none."""
    system = problem.system
    low, high = system.control_bounds
    controls = np.vstack((0.5 * (low + high), low, high, np.clip(0.0, low, high), low + 0.3 * (high - low)))
    with np.errstate(all="ignore"):
        rates = system.dynamics(np.tile(start, (len(controls), 1)), controls)
    if np.isfinite(rates).all(axis=1).any():
        return ""
    index = int(np.flatnonzero(~np.isfinite(rates).any(axis=0) | ~np.isfinite(rates).all(axis=0))[0])
    at = ", ".join(f"{name} = {value:g}" for name, value in zip(system.state_names, start, strict=True))
    return (f"start: the model's rate of {system.state_names[index]} is {rates[0, index]:g} at {at}, whatever the "
            "control: start elsewhere, or give the equation a value there")  # fmt: skip


def singular_derivative(problem: OptimalControlProblem, start: Array) -> str:
    """Describe a derivative of the model that is not finite at a start (n,); empty if there is none."""
    system = problem.system
    x, u = casadi.SX.sym("x", len(system.states)), casadi.SX.sym("u", len(system.controls))
    by_state = casadi.Function("f_x", [x, u], [casadi.jacobian(system.dynamics(x, u, math=casadi), x)])
    values = by_state(start, system.control_bounds.mean(axis=0)).full()
    for row, column in np.argwhere(~np.isfinite(values)):
        names, value = system.state_names, values[row, column]
        return f"the derivative of the rate of {names[row]} by {names[column]} is {value:g} at the start"
    return ""
