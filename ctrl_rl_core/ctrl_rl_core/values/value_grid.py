"""A value function on a regular grid: its description, its file, and its value and gradient at any state.

    grid = ValueGrid.load("car_ttr.safetensors")
    phi = grid.at(np.array([0.0, 1.0, 0.5]))       # one state, the fastest way
    phi, gradient = grid.value_and_gradient(states)  # (N, 3) -> (N,), (N, 3)

See `interpolation` for the treatment of +inf (unreachable) and of states outside the domain (NaN).
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property, partial
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ValidationError

from ctrl_rl_core.io.file_checks import first_error, raise_as
from ctrl_rl_core.values import grid_file
from ctrl_rl_core.values.cells import axis_table
from ctrl_rl_core.values.grid_axis import Axis, GridError
from ctrl_rl_core.values.interpolation import gradient_at, gradients_at, value_at, values_at

__all__ = ["KIND_UNITS", "Axis", "GridError", "ValueGrid"]

KIND_UNITS = {"time_to_reach": "s", "oc_value": "1", "avoid": "m", "reach_avoid": "m"}
_MAX_DIMENSIONS = 6
_FORMAT = 1


@dataclass(frozen=True, eq=False)
class ValueGrid:
    """A value function on a regular grid of one to six dimensions; immutable.

    Attributes:
        values: Shape (count of axis 0, ...), float32 or float64, read-only. Times to reach are non-negative and may be
            +inf (unreachable); other values are finite.
        axes: One axis per dimension of `values`, in the order of the state's components.
        kind: "time_to_reach" (thesis Eq. 2.18), "oc_value" (thesis Eq. 3.13), or "avoid" and "reach_avoid": guaranteed
            distance from everything to be avoided, for "reach_avoid" also on the way to a target; safe if >= 0.
        task: Name of the task that the values belong to.
        task_digest: SHA-256 of that task, 64 hexadecimal digits.
        solver: Name of the solver that computed the values.
        residual: Final residual of the solver [unit of the values], >= 0.
        notes: Further metadata, text by name.
        at: Fastest evaluation at one state, a C-contiguous float64 array (n,); raises GridError for another size.

    Raises:
        GridError: An attribute violates the above.
    """

    values: NDArray[np.float32] | NDArray[np.float64]
    axes: tuple[Axis, ...]
    kind: str
    task: str
    task_digest: str
    solver: str
    residual: float
    notes: Mapping[str, str] = field(default_factory=dict)
    at: Callable[[NDArray[np.float64]], float] = field(init=False, repr=False)
    _table: NDArray[np.float64] = field(init=False, repr=False)
    _own_values: NDArray[Any] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        _check_description(self)
        values: NDArray[Any] = np.array(self.values, order="C")
        _check_values(values, tuple(self.axes), self.kind)
        public = values.view()
        public.flags.writeable = False
        table = axis_table(self.axes)
        derived = {
            "values": public,
            "axes": tuple(self.axes),
            "notes": dict(self.notes),
            "_table": table,
            # The kernels get the writable array, because Numba would recompile for a read-only one.
            "_own_values": values,
            "at": partial(value_at, values, table),
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    @property
    def unit(self) -> str:
        """Unit of the values: "s", "1" or "m"."""
        return KIND_UNITS[self.kind]

    @property
    def state_names(self) -> tuple[str, ...]:
        """Components of the state, in the order of the axes."""
        return tuple(axis.name for axis in self.axes)

    @property
    def grids(self) -> tuple[Self, ...]:
        """The grid itself; a value function may also consist of several grids."""
        return (self,)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the file written by `save`, 64 hexadecimal digits."""
        return hashlib.sha256(self._encode()).hexdigest()

    def value(self, states: ArrayLike) -> NDArray[np.float64]:
        """Return the values at states.

        Args:
            states: Shape (n,) or (..., n), in the order and units of the axes.

        Returns:
            Shape (...), NaN outside the domain, +inf where the goal is unreachable [unit of the values].

        Raises:
            GridError: The last dimension of `states` is not n.
        """
        rows, shape = self._rows(states)
        out = np.empty(len(rows))
        values_at(self._own_values, self._table, rows, out)
        return out.reshape(shape)

    def value_and_gradient(self, states: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return values (...) and gradients (..., n) at states; arguments, units and errors as for `value`.

        A gradient [unit of the values per unit of the axis] is NaN where the value is NaN or +inf.
        """
        rows, shape = self._rows(states)
        out, gradients = np.empty(len(rows)), np.empty(rows.shape)
        gradients_at(self._own_values, self._table, rows, out, gradients)
        return out.reshape(shape), gradients.reshape(*shape, len(self.axes))

    def value_and_gradient_at(self, state: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """As `value_and_gradient` for one state, but faster: a C-contiguous float64 array (n,), without conversions."""
        gradient = np.empty(len(self.axes))
        return gradient_at(self._own_values, self._table, state, gradient), gradient

    def in_domain(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Return whether each state (..., n) lies inside the grid, edges included, shape (...).

        Errors as for `value`.
        """
        return ~np.isnan(self.value(states))

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write the grid to a safetensors file, atomically.

        Raises:
            GridError: The file exists and `overwrite` is false, or cannot be written.
        """
        grid_file.write_grid_file(Path(path), self._encode(), overwrite=overwrite)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Load and validate a grid.

        Raises:
            GridError: The file cannot be read or is not a grid; the message names the file and the error.
        """
        with raise_as(GridError, path):
            values, axes, text = grid_file.read(Path(path))
            return cls(values=values, axes=axes, **text)

    def _encode(self) -> bytes:
        description = {name: getattr(self, name) for name in _DESCRIPTION}
        return grid_file.encode(
            self.values,
            {**description, "axes": [asdict(axis) for axis in self.axes], "format": _FORMAT, "unit": self.unit},
        )

    def _rows(self, states: ArrayLike) -> tuple[NDArray[np.float64], tuple[int, ...]]:
        """Return the states as rows (N, n), and their original shape (...)."""
        try:
            array = np.asarray(states, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise GridError(f"the states are not an array of numbers: {error}") from error
        n = len(self.axes)
        if array.shape[-1:] != (n,):
            names = ", ".join(axis.name for axis in self.axes)
            raise GridError(f"the states have shape {array.shape}; give (..., {n}), one component per axis: {names}")
        return np.require(array.reshape(-1, n), requirements=["C", "W"]), array.shape[:-1]


_DESCRIPTION = ("kind", "task", "task_digest", "solver", "residual", "notes")


def _check_description(grid: ValueGrid) -> None:
    """Validate a grid against the schema of its file."""
    try:
        grid_file.GridText.model_validate({name: getattr(grid, name) for name in _DESCRIPTION})
    except ValidationError as error:
        raise GridError(first_error(error)) from None


def _check_values(values: NDArray[Any], axes: tuple[Axis, ...], kind: str) -> None:
    if not 1 <= len(axes) <= _MAX_DIMENSIONS:
        raise GridError(f"there are {len(axes)} axes; give one to {_MAX_DIMENSIONS}")
    names = [axis.name for axis in axes]
    if len(set(names)) != len(names):
        raise GridError(f"the axes' names repeat: {', '.join(names)}")
    if values.dtype not in (np.float32, np.float64):
        raise GridError(f"the values are of type {values.dtype}; give float32 or float64")
    counts = tuple(axis.count for axis in axes)
    if values.shape != counts:
        raise GridError(f"the values have shape {values.shape}, the axes {counts}")
    if np.isnan(values).any() or np.isneginf(values).any():
        raise GridError("there are values that are NaN or -inf")
    if kind == "time_to_reach" and values.min() < 0:
        raise GridError(f"a time to reach is negative ({values.min():g} s)")
    if kind != "time_to_reach" and np.isinf(values).any():
        name = "an optimal control value" if kind == "oc_value" else "a safety value"
        raise GridError(f"{name} is infinite")
