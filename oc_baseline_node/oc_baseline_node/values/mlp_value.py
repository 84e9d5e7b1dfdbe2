"""A value function as a small network, V_oc of thesis 3.3.2, evaluated in NumPy only.

Inputs are the state's components scaled to [-1, 1] over their domain, with an angle as its cosine and sine; layers are
tanh; the output is scaled back to reward. Implements `ctrl_rl_core.values.value_function.ValueFunction`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from ctrl_rl_core.io import encode_tensors
from ctrl_rl_core.values import Axis, batches
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import ValueGrid
from oc_baseline_node.errors import OcError
from oc_baseline_node.values.collision_set import CollisionSet

FORMAT = "oc-value-mlp-1"
HEADER_KEY = "oc_value"

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MlpValue:
    """V_oc over a box of states; NaN outside.

    Attributes:
        layers: Weights (out, in) and biases (out,) of each layer; the last has one output.
        axes: Name, unit, domain and number of grid nodes of each state component.
        offset: Offset of the scaled output [reward].
        scale: Scale of the network's output [reward].
        task: Name of the task.
        task_digest: SHA-256 of the task.
        collisions: States with a known value; None to use only the network.
        manifest: Description of the data and the quality of the fit, plain JSON values.

    Raises:
        OcError: Shapes are inconsistent, or numbers are not finite.
    """

    layers: tuple[tuple[Array, Array], ...]
    axes: tuple[Axis, ...]
    offset: float
    scale: float
    task: str
    task_digest: str
    collisions: CollisionSet | None = None
    manifest: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        width = feature_count(self.axes)
        for index, (weight, bias) in enumerate(self.layers):
            if weight.ndim != 2 or weight.shape[1] != width or bias.shape != weight.shape[:1]:
                raise OcError(
                    f"layer {index} has shapes {weight.shape} and {bias.shape}, but its input has {width} numbers"
                )
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise OcError(f"layer {index} holds numbers that are not finite")
            width = weight.shape[0]
        if width != 1:
            raise OcError(f"the last layer has {width} outputs; it must have 1")

    @property
    def kind(self) -> str:
        """Always "oc_value"."""
        return "oc_value"

    @property
    def state_names(self) -> tuple[str, ...]:
        """Components of the state, in order."""
        return tuple(axis.name for axis in self.axes)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the file written for this network."""
        return hashlib.sha256(self.encoded).hexdigest()

    @property
    def encoded(self) -> bytes:
        """Bytes of the network's file, read by `value_file.load_value`; deterministic for the same network."""
        tensors = {}
        for index, (weight, bias) in enumerate(self.layers):
            tensors[f"weight_{index}"] = np.ascontiguousarray(weight, dtype=np.float32)
            tensors[f"bias_{index}"] = np.ascontiguousarray(bias, dtype=np.float32)
        header = {
            "format": FORMAT,
            "task": self.task,
            "task_digest": self.task_digest,
            "axes": [asdict(axis) for axis in self.axes],
            "activation": "tanh",
            "offset": self.offset,
            "scale": self.scale,
            "collisions": None if self.collisions is None else self.collisions.as_json(),
            "manifest": dict(self.manifest),
        }
        return encode_tensors(tensors, HEADER_KEY, header)

    @cached_property
    def grids(self) -> tuple[ValueGrid, ...]:
        """Values at the nodes of the axes, as one grid."""
        figures = self.manifest.get("held_out", {})
        notes = {"discount": str(self.manifest.get("discount", "")), "network": self.digest}
        return (
            ValueGrid(
                values=self._values_at_nodes(),
                axes=self.axes,
                kind=self.kind,
                task=self.task,
                task_digest=self.task_digest,
                solver="MPC trajectories, Eq. 3.13, tanh network",
                residual=float(figures.get("rmse", 0.0)),
                notes=notes,
            ),
        )

    def _values_at_nodes(self) -> NDArray[np.float32]:
        """Return the values at all nodes of the axes, in batches, since six components have millions of nodes."""
        out = np.empty([axis.count for axis in self.axes], dtype=np.float32)
        flat, nodes = out.reshape(-1), [axis.nodes for axis in self.axes]
        for part in batches(flat.size):
            indices = np.unravel_index(np.arange(part.start, part.stop), out.shape)
            states = [of_axis[index] for of_axis, index in zip(nodes, indices, strict=True)]
            flat[part] = self.value(np.column_stack(states))
        return out

    def value(self, states: ArrayLike) -> Array:
        """Values (...) at states (..., n), NaN outside the domain.

        Raises:
            OcError: The last dimension of the states is not n.
        """
        rows, shape = self._rows(states)
        out = np.empty(len(rows))
        for part in batches(len(rows)):
            out[part] = self._forward(rows[part])[0]
            self._replace(rows[part], out[part])
        return out.reshape(shape)

    def value_and_gradient(self, states: ArrayLike) -> tuple[Array, Array]:
        """Values (...) and gradients (..., n) at states (..., n), NaN outside the domain. Errors as for `value`."""
        rows, shape = self._rows(states)
        value, hidden = self._forward(rows)
        slope = np.full((len(rows), 1), self.scale)
        for (weight, _), h in zip(self.layers[:0:-1], hidden[::-1], strict=True):
            slope = (slope @ weight) * (1.0 - h * h)
        gradient = feature_gradient(self.axes, rows, slope @ self.layers[0][0])
        collision = self._replace(rows, value)
        gradient[collision], gradient[np.isnan(value)] = 0.0, np.nan
        return value.reshape(shape), gradient.reshape(*shape, len(self.axes))

    def value_and_gradient_at(self, state: Array) -> tuple[float, Array]:
        """Value and gradient (n,) at one state (n,)."""
        value, gradient = self.value_and_gradient(state[None])
        return float(value[0]), gradient[0]

    def clipped(self, states: ArrayLike) -> Array:
        """Clip states (..., n) to the domain."""
        low, high = self._domain
        return np.clip(np.asarray(states, dtype=float), low, high)

    def without_collisions(self) -> MlpValue:
        """Return only the network, which is smooth across the edges of obstacles."""
        return replace(self, collisions=None)

    def _replace(self, rows: Array, values: Array) -> NDArray[np.bool_]:
        """Replace the network's values (N,) of colliding rows (N, n) by the known ones; return which rows collide."""
        collision = np.zeros(len(rows), dtype=bool)
        if self.collisions is not None:
            paid = self.collisions.rewards(self.state_names, rows)
            collision = ~np.isnan(paid)
            values[collision] = paid[collision]
        values[~self._inside(rows)] = np.nan
        return collision

    @cached_property
    def _domain(self) -> tuple[Array, Array]:
        """Minimum and maximum state (n,); infinite for an angle, which wraps."""
        low = np.array([-np.inf if axis.periodic else axis.lower for axis in self.axes])
        high = np.array([np.inf if axis.periodic else axis.upper for axis in self.axes])
        return low, high

    def _inside(self, rows: Array) -> NDArray[np.bool_]:
        low, high = self._domain
        return np.all((rows >= low) & (rows <= high) & np.isfinite(rows), axis=1)

    def _forward(self, rows: Array) -> tuple[Array, list[Array]]:
        """Return values (N,) and the outputs of the hidden layers."""
        h, hidden = features(self.axes, rows), []
        for weight, bias in self.layers[:-1]:
            h = np.tanh(h @ weight.T + bias)
            hidden.append(h)
        weight, bias = self.layers[-1]
        return self.offset + self.scale * (h @ weight[0] + bias[0]), hidden

    def _rows(self, states: ArrayLike) -> tuple[Array, tuple[int, ...]]:
        array = np.asarray(states, dtype=float)
        if array.shape[-1:] != (len(self.axes),):
            raise OcError(
                f"states have shape {array.shape}, give (..., {len(self.axes)}): {', '.join(self.state_names)}"
            )
        return array.reshape(-1, len(self.axes)), array.shape[:-1]


def feature_count(axes: tuple[Axis, ...]) -> int:
    """Return the number of inputs."""
    return sum(2 if axis.periodic else 1 for axis in axes)


def features(axes: tuple[Axis, ...], rows: Array) -> Array:
    """Return the network's inputs (N, F) for states (N, n): cosine and sine of angles, the rest scaled to [-1, 1]."""
    columns: list[Array] = []
    for index, axis in enumerate(axes):
        x = rows[:, index]
        if axis.periodic:
            phase = _turn(axis) * (x - axis.lower)
            columns += [np.cos(phase), np.sin(phase)]
        else:
            columns.append((x - 0.5 * (axis.lower + axis.upper)) / (0.5 * (axis.upper - axis.lower)))
    return np.column_stack(columns)


def feature_gradient(axes: tuple[Axis, ...], rows: Array, slope: Array) -> Array:
    """Return the gradient with respect to states (N, n), given that with respect to features (N, F)."""
    out, column = np.empty(rows.shape), 0
    for index, axis in enumerate(axes):
        if axis.periodic:
            turn = _turn(axis)
            phase = turn * (rows[:, index] - axis.lower)
            out[:, index] = turn * (np.cos(phase) * slope[:, column + 1] - np.sin(phase) * slope[:, column])
            column += 2
        else:
            out[:, index] = slope[:, column] / (0.5 * (axis.upper - axis.lower))
            column += 1
    return out


def _turn(axis: Axis) -> float:
    return 2.0 * np.pi / (axis.upper - axis.lower)
