"""The maximum of several value grids over parts of a state, with the same questions as a `ValueGrid`, and its file."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np
from ctrl_rl_core.grid_axis import Axis, GridError
from ctrl_rl_core.grid_file import values_digest, write
from ctrl_rl_core.value_grid import ValueGrid
from numpy.typing import ArrayLike, NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

HEADER_KEY = "decomposed_value"
_FORMAT = 1
_FIELDS = ("kind", "task", "task_digest", "solver", "residual", "notes")
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DecomposedValue:
    """phi(x) >= max over the subsystems of phi_i(x_i): a lower bound of the time to reach.

    Attributes:
        grids: of the subsystems; their axes are named after the states that they keep.
        axes: of the whole state, in order.
        name: of the decomposition.
        free: for each subsystem, the states and controls that it treats as its own to choose.

    Raises:
        GridError: a grid has an axis that the whole lacks.
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
        """What it is: "time_to_reach"."""
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
        """Values (...) at states (..., n) [s]; NaN outside the domain, +inf where a part cannot reach its target."""
        return self._values(np.asarray(states, dtype=np.float64)).max(axis=0)

    def value_and_gradient(self, states: ArrayLike) -> tuple[Array, Array]:
        """Values (...) and gradients (..., n) [s per unit of the axis]; the gradient is that of the largest part."""
        x = np.asarray(states, dtype=np.float64)
        value, gradient = np.full(x.shape[:-1], -np.inf), np.zeros(x.shape)
        for grid, columns in zip(self.grids, self._columns, strict=True):
            part, slope = grid.value_and_gradient(x[..., columns])
            larger = ~(part <= value)  # NaN wins, and stays
            larger &= ~np.isnan(value)
            value = np.where(larger, part, value)
            whole = np.zeros(x.shape)
            whole[..., columns] = slope
            gradient = np.where(larger[..., None], whole, gradient)
        bad = ~np.isfinite(value)
        gradient[bad] = np.nan
        return value, gradient

    def at(self, state: Array) -> float:
        """Value at one state (n,), quickly; NaN outside the domain."""
        return self._largest_at(state)[0]

    def value_and_gradient_at(self, state: Array) -> tuple[float, Array]:
        """Value and gradient (n,) at one state (n,), quickly; the gradient is that of the largest part."""
        value, largest = self._largest_at(state)
        gradient = np.full(len(self.axes), np.nan)
        if math.isfinite(value):
            columns = self._columns[largest]
            gradient[:] = 0.0
            gradient[columns] = self.grids[largest].value_and_gradient_at(state[columns])[1]
        return value, gradient

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write all grids as one safetensors file, whole or not at all.

        Raises:
            GridError: the file exists and `overwrite` is false, or it cannot be written.
        """
        write(Path(path), self._encode(), overwrite=overwrite)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read and check a file that `save` wrote.

        Raises:
            GridError: names the file and what is wrong with it.
        """
        try:
            with safe_open(path, framework="numpy") as file:
                header = json.loads((file.metadata() or {})[HEADER_KEY])
                if header["format"] != _FORMAT:
                    raise GridError(f"format is {header['format']!r}; this version reads format {_FORMAT}")
                tensors = [file.get_tensor(f"values_{i}") for i in range(len(header["grids"]))]
            for values, description in zip(tensors, header["grids"], strict=True):
                if description["values_sha256"] != values_digest(values):
                    raise GridError("has values that do not match their checksum; copy or compute it again")
            axes = tuple(Axis(**axis) for axis in header["axes"])
            by_name = {axis.name: axis for axis in axes}
            grids = tuple(
                ValueGrid(
                    values=values,
                    axes=tuple(by_name[name] for name in description["axes"]),
                    **{key: description[key] for key in _FIELDS},
                )
                for values, description in zip(tensors, header["grids"], strict=True)
            )
            return cls(grids, axes, header["name"], tuple(tuple(names) for names in header["free"]))
        except FileNotFoundError as error:
            raise GridError(f"{path}: there is no such file; compute it first or correct the path") from error
        except OSError as error:
            raise GridError(f"{path}: cannot be read: {error.strerror or error}") from error
        except (SafetensorError, KeyError, TypeError, ValueError) as error:
            raise GridError(f"{path}: is not a decomposed value function ({error})") from error
        except GridError as error:
            raise GridError(f"{path}: {error}") from error

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
                    "values_sha256": values_digest(grid.values),
                }
                for grid in self.grids
            ],
        }
        tensors = {f"values_{i}": np.ascontiguousarray(grid.values) for i, grid in enumerate(self.grids)}
        return save(tensors, metadata={HEADER_KEY: json.dumps(header, sort_keys=True, allow_nan=False)})

    def _largest_at(self, state: Array) -> tuple[float, int]:
        """Value at one state (n,), and which part it is of."""
        parts = [grid.at(state[columns]) for grid, columns in zip(self.grids, self._columns, strict=True)]
        # NaN wins: numpy's argmax takes the first of them
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
        """For each grid, where its states are in the whole's."""
        return tuple([self.state_names.index(axis.name) for axis in grid.axes] for grid in self.grids)


def _plain(value: Any) -> Any:
    return dict(value) if hasattr(value, "items") else value
