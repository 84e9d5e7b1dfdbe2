"""Games of safety whose values are known: braking before walls, two identical cars, a car that is pursued."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from merz import RADIUS, SPEED, golden_points
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from ctrl_rl_core import Axis, Quantity, System
from ttr_reward_node import SafetyGame

Array = NDArray[np.float64]
PURSUER_SPEED = 0.4
"""Speed of the pursuer along each axis [m/s]; the car drives at 1 m/s and turns by up to 1 rad/s."""
PURSUER_RADIUS = 0.5
"""Distance that the car is to keep from the pursuer's middle [m]."""
_WRAP = 8  # nodes of a periodic axis that are repeated at either end


@dataclass(frozen=True, eq=False)
class SafetyCase:
    """A game, its margin, and states whose values are known.

    Attributes:
        name: Name of the game.
        game: System and axes.
        margin: Margin at the nodes (grid shape) [m].
        horizon: Time [s] after which the value no longer changes at the states.
        length: Size of what is avoided [m], to which errors are related.
        states: States (N, n).
        values: Their values (N,) [m].
    """

    name: str
    game: SafetyGame
    margin: Array
    horizon: float
    length: float
    states: Array
    values: Array

    def errors(self, values: NDArray[np.floating]) -> Array:
        """Return errors (N,) [m] of values at the nodes (grid shape), between them by cubic splines."""
        places, pad = [], []
        for k, axis in enumerate(self.game.axes):
            pad.append((_WRAP, _WRAP) if axis.periodic else (0, 0))
            offset = self.states[:, k] - axis.lower
            offset = np.mod(offset, axis.upper - axis.lower) if axis.periodic else offset
            places.append(offset / axis.spacing + pad[-1][0])
        padded = np.pad(np.asarray(values, dtype=np.float64), pad, mode="wrap")
        return np.asarray(map_coordinates(padded, places, order=3, mode="nearest") - self.values)


def double_integrator(count: int = 161, disturbance: float = 0.2) -> SafetyCase:
    """Make the game of braking between walls at +-1 m: x'' = u + d, |u| <= 1 m/s^2.

    With a = 1 - |d| braking ends at x + v |v| / (2 a).
    The states are the nodes from which braking ends on the grid.
    """
    states = (Quantity("x", "m"), Quantity("v", "m/s"))
    system = _system(
        "double_integrator", lambda _m, _p: lambda x, u, d: (x[1] + d[0], u[0] + d[1]), states, (0.0, disturbance)
    )
    game = SafetyGame(system, (Axis("x", "m", -1.5, 1.5, count), Axis("v", "m/s", -2.0, 2.0, count)))
    x, v = (each.ravel() for each in _nodes(game))
    stop = x + v * np.abs(v) / (2.0 * (1.0 - disturbance))
    kept = np.abs(stop) <= 1.5
    values = 1.0 - np.maximum(np.abs(x), np.abs(stop))
    margin = 1.0 - np.abs(_nodes(game)[0])
    return SafetyCase("double integrator", game, margin, 2.6, 1.0, np.column_stack((x, v))[kept], values[kept])


def air3d(counts: tuple[int, int, int] = (71, 61, 63), points: int = 20_000) -> SafetyCase:
    """Make Merz's game of two identical cars, the evader at the origin; the states lie about the edge of the set."""
    states = (Quantity("x", "m"), Quantity("y", "m"), _angle("psi"))

    def equations(m, _p):  # type: ignore[no-untyped-def]
        return lambda x, u, d: (
            -SPEED + SPEED * m.cos(x[2]) + u[0] * x[1],
            SPEED * m.sin(x[2]) - u[0] * x[0],
            d[2] - u[0],
        )

    x, y, psi = counts
    axes = (Axis("x", "m", -7.0, 21.0, x), Axis("y", "m", -12.0, 12.0, y), Axis("psi", "rad", -np.pi, np.pi, psi, True))
    game = SafetyGame(_system("air3d", equations, states, (0.0, 0.0, 1.0)), axes)
    random = np.random.default_rng(0)
    known, values = golden_points((4.5, 5.0, 5.5), random.uniform(0.0, 2.0 * np.pi, 200), 2.7)
    inside = np.all([(known[:, k] > axes[k].lower + 1.0) & (known[:, k] < axes[k].upper - 1.0) for k in (0, 1)], axis=0)
    chosen = random.permutation(np.flatnonzero(inside))[:points]
    margin = np.hypot(*_nodes(game)[:2]) - RADIUS
    return SafetyCase("air3D", game, margin, 2.8, RADIUS, known[chosen], values[chosen])


def pursuit(counts: tuple[int, int, int] = (91, 91, 72), points: int = 20_000) -> SafetyCase:
    """Make the game of a car of 1 m/s that turns by up to 1 rad/s, pursued by a slower point that needs no turns.

    The states are nodes at most 2 m away from the pursuer along each axis.
    """
    states = (Quantity("x", "m"), Quantity("y", "m"), _angle("theta"))
    slow = (PURSUER_SPEED, PURSUER_SPEED, 0.0)
    system = _system(
        "pursued_car", lambda m, _p: lambda x, u, d: (m.cos(x[2]) + d[0], m.sin(x[2]) + d[1], u[0] + d[2]), states, slow
    )
    x, y, theta = counts
    axes = (
        Axis("x", "m", -3.0, 3.0, x),
        Axis("y", "m", -3.0, 3.0, y),
        Axis("theta", "rad", -np.pi, np.pi, theta, True),
    )
    game = SafetyGame(system, axes)
    known = np.stack(_nodes(game), axis=-1).reshape(-1, 3)
    apart = np.hypot(known[:, 0], known[:, 1])
    inside = np.flatnonzero((np.abs(known[:, :2]).max(axis=1) <= 2.0) & (apart > PURSUER_RADIUS))
    chosen = np.random.default_rng(0).permutation(inside)[:points]
    margin = np.hypot(*_nodes(game)[:2]) - PURSUER_RADIUS
    return SafetyCase(
        "Dubins pursuit", game, margin, 3.0, PURSUER_RADIUS, known[chosen], _least_distance(known[chosen])
    )


def _least_distance(states: Array, samples: int = 1001) -> Array:
    """Least distance (N,) [m], less the radius, that the pursued car can keep.

    It turns one way until the pursuer no longer comes nearer; then it drives straight on, faster than the pursuer. What
    the pursuer has reached by then is a square around its start.
    """
    best = np.full(len(states), -np.inf)
    x, y, theta = states.T
    for side in (-1.0, 1.0):
        least, nearing = np.full(len(states), np.inf), np.ones(len(states), dtype=bool)
        for time in np.linspace(0.0, 4.0, samples):
            heading = theta + side * time
            px, py = x + side * (np.sin(heading) - np.sin(theta)), y - side * (np.cos(heading) - np.cos(theta))
            reached = PURSUER_SPEED * time
            distance = np.hypot(np.maximum(np.abs(px) - reached, 0.0), np.maximum(np.abs(py) - reached, 0.0))
            nearing &= distance <= least
            least = np.where(nearing, distance, least)
        best = np.maximum(best, least)
    return best - PURSUER_RADIUS


def _system(
    name: str, equations: Callable[..., object], states: tuple[Quantity, ...], most: tuple[float, ...]
) -> System:
    """Return a system with one control within +-1 and the given largest disturbances."""
    disturbances = tuple(
        Quantity(f"d_{state.name}", f"{state.unit}/s", -size, size) for state, size in zip(states, most, strict=True)
    )
    controls = (Quantity("u", "1", -1.0, 1.0),)
    return System(name, states, controls, disturbances, {}, equations)  # type: ignore[arg-type]


def _angle(name: str) -> Quantity:
    return Quantity(name, "rad", -np.pi, np.pi, periodic=True)


def _nodes(game: SafetyGame) -> list[Array]:
    return list(np.meshgrid(*(axis.nodes for axis in game.axes), indexing="ij"))
