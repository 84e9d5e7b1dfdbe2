"""Maximum of several value grids over parts of the state, with the interface of a `ValueGrid`, and its file."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from ctrl_rl_core.io import FileError, Name, Schema, encode_tensors, raise_as, read_tensors, short_repr
from ctrl_rl_core.values import AxisHeader, GridText, write_grid_file
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from ctrl_rl_core import Axis, GridError, ValueGrid

HEADER_KEY = "decomposed_value"
_FORMAT = 1
_FIELDS = ("kind", "task", "task_digest", "solver", "residual", "notes")
Array = NDArray[np.float64]


class _Part(GridText):
    """Header of a subsystem's grid in the file."""

    axes: Annotated[list[Name], Field(min_length=1, max_length=6)]

    def grid(self, values: NDArray[Any], axes: Sequence[Axis]) -> ValueGrid:
        self.check(values)
        return ValueGrid(values=values, axes=tuple(axes), **{name: getattr(self, name) for name in _FIELDS})


class _Header(Schema):
    """Header of the file."""

    format: Literal[1]
    name: Name
    free: Annotated[list[Annotated[list[Name], Field(max_length=50)]], Field(max_length=50)]
    axes: Annotated[list[AxisHeader], Field(min_length=1, max_length=50)]
    grids: Annotated[list[_Part], Field(min_length=1, max_length=50)]


@dataclass(frozen=True, eq=False)
class DecomposedValue:
    """phi(x) >= max over the subsystems of phi_i(x_i): a lower bound of the time to reach.

    Attributes:
        grids: Value grids of the subsystems; their axes have the names of the kept states.
        axes: Axes of the whole state, in order.
        name: Name of the decomposition.
        free: For each subsystem, the states and controls that it chooses freely.

    Raises:
        GridError: A grid has an axis that the whole state lacks.
    """

    grids: tuple[ValueGrid, ...]
    axes: tuple[Axis, ...]
    name: str
    free: tuple[tuple[str, ...], ...]

    def __post_init__(self) -> None:
        names = [axis.name for axis in self.axes]
        for grid in self.grids:
            for axis in grid.axes:
                if axis.name not in names:
                    raise GridError(f"a subsystem has axis '{axis.name}'; the whole has {', '.join(names)}")

    @property
    def task(self) -> str:
        """Name of the task."""
        return self.grids[0].task

    @property
    def task_digest(self) -> str:
        """SHA-256 of the task."""
        return self.grids[0].task_digest

    @property
    def kind(self) -> str:
        """Kind of the values, "time_to_reach"."""
        return self.grids[0].kind

    @property
    def state_names(self) -> tuple[str, ...]:
        """Components of the state, in order."""
        return tuple(axis.name for axis in self.axes)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the file that `save` writes, 64 hexadecimal digits."""
        return hashlib.sha256(self._encode()).hexdigest()

    def value(self, states: ArrayLike) -> Array:
        """Return values (...) at states (..., n) [s]; NaN outside the domain, +inf if a part cannot reach its goal."""
        return self._values(np.asarray(states, dtype=np.float64)).max(axis=0)

    def value_and_gradient(self, states: ArrayLike) -> tuple[Array, Array]:
        """Return values (...) and gradients (..., n) [s per unit of the axis] of the largest part."""
        x = np.asarray(states, dtype=np.float64)
        value, gradient = np.full(x.shape[:-1], -np.inf), np.zeros(x.shape)
        for grid, columns in zip(self.grids, self._columns, strict=True):
            part, slope = grid.value_and_gradient(x[..., columns])
            larger = ~(part <= value)  # NaN takes precedence
            larger &= ~np.isnan(value)
            value = np.where(larger, part, value)
            whole = np.zeros(x.shape)
            whole[..., columns] = slope
            gradient = np.where(larger[..., None], whole, gradient)
        bad = ~np.isfinite(value)
        gradient[bad] = np.nan
        return value, gradient

    def at(self, state: Array) -> float:
        """Return the value at one state (n,), optimised for speed; NaN outside the domain."""
        return self._largest_at(state)[0]

    def value_and_gradient_at(self, state: Array) -> tuple[float, Array]:
        """Return value and gradient (n,) of the largest part at one state (n,), optimised for speed."""
        value, largest = self._largest_at(state)
        gradient = np.full(len(self.axes), np.nan)
        if math.isfinite(value):
            columns = self._columns[largest]
            gradient[:] = 0.0
            gradient[columns] = self.grids[largest].value_and_gradient_at(state[columns])[1]
        return value, gradient

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write all grids to one safetensors file, atomically.

        Raises:
            GridError: The file exists and `overwrite` is false, or it cannot be written.
        """
        write_grid_file(Path(path), self._encode(), overwrite=overwrite)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read and check a file written by `save`.

        Raises:
            GridError: The file is missing or damaged, or has other contents.
        """
        with raise_as(GridError, path):
            header, tensors, _ = read_tensors(path, HEADER_KEY, largest=None, finite=False)
            told = _Header.model_validate(header)
            axes = tuple(each.axis for each in told.axes)
            by_name = {axis.name: axis for axis in axes}
            wanted = [f"values_{i}" for i in range(len(told.grids))]
            if sorted(tensors) != sorted(wanted) or len(by_name) < len(axes):
                raise FileError(f"must hold {len(wanted)} grids, over axes of different names")
            unknown = [name for part in told.grids for name in part.axes if name not in by_name]
            if unknown:
                raise FileError(f"a subsystem has axis {short_repr(unknown[0])}; the whole has {', '.join(by_name)}")
            grids = [
                part.grid(tensors[name], [by_name[axis] for axis in part.axes])
                for name, part in zip(wanted, told.grids, strict=True)
            ]
            return cls(tuple(grids), axes, told.name, tuple(tuple(names) for names in told.free))

    def _encode(self) -> bytes:
        header = {
            "format": _FORMAT,
            "name": self.name,
            "free": self.free,
            "axes": [asdict(axis) for axis in self.axes],
            "grids": [
                {
                    **{key: _plain(getattr(grid, key)) for key in _FIELDS},
                    "axes": [axis.name for axis in grid.axes],
                }
                for grid in self.grids
            ],
        }
        return encode_tensors({f"values_{i}": grid.values for i, grid in enumerate(self.grids)}, HEADER_KEY, header)

    def _largest_at(self, state: Array) -> tuple[float, int]:
        """Return the value at one state (n,), and the index of the part that attains it."""
        parts = [grid.at(state[columns]) for grid, columns in zip(self.grids, self._columns, strict=True)]
        # NaN takes precedence: NumPy's argmax returns the first one.
        largest = int(np.argmax(parts))
        return parts[largest], largest

    def _values(self, x: Array) -> Array:
        if x.shape[-1:] != (len(self.axes),):
            names = ", ".join(self.state_names)
            raise GridError(f"states of shape {x.shape}: give (..., {len(self.axes)}), one component per axis: {names}")
        parts = zip(self.grids, self._columns, strict=True)
        return np.stack([grid.value(x[..., columns]) for grid, columns in parts])

    @cached_property
    def _columns(self) -> tuple[Sequence[int], ...]:
        """For each grid, the indices of its states in the whole state."""
        return tuple([self.state_names.index(axis.name) for axis in grid.axes] for grid in self.grids)


def _plain(value: Any) -> Any:
    return dict(value) if hasattr(value, "items") else value
