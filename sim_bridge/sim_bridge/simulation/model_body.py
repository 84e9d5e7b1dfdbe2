"""A disc-shaped body that moves exactly as a system model, for custom robots without a URDF."""

from __future__ import annotations

import math

import numpy as np
from ctrl_rl_core.tasks import ANGLES
from numpy.typing import NDArray

from ctrl_rl_core import System
from sim_bridge.engines.engine import PlacedDisc
from sim_bridge.simulation.lidar import SensorPose

Array = NDArray[np.float64]

LIDAR_HEIGHT = 0.1
"""Height of the lidar above the floor of the x-y plane [m], at the disc's centre."""


def advance(system: System, states: Array, commands: Array, step: float) -> Array:
    """Integrate states (..., n) over one step [s], clipped to the model's bounds."""
    low = [-math.inf if state.periodic else state.lower for state in system.states]
    high = [math.inf if state.periodic else state.upper for state in system.states]
    return system.wrap(np.clip(system.step(states, commands, dt=step), low, high))


class ModelBody:
    """A `Body` whose state is integrated by fourth-order Runge-Kutta steps.

    Args:
        disc: The body in the engine.
        system: Model with the task's parameters.
        bounds: Minimum and maximum commands (2, 2).
        start: State at the start (n,).
        radius: Radius of the disc [m].
        rate: Physics steps per second [Hz].
    """

    def __init__(self, disc: PlacedDisc, system: System, bounds: Array, start: Array, radius: float, rate: int) -> None:
        self.bounds, self.radius = bounds, radius
        self.idle = np.clip(np.zeros(2), bounds[:, 0], bounds[:, 1])
        self._disc, self._system, self._step = disc, system, 1.0 / rate
        names = list(system.state_names)
        self._flat = "z" not in names
        self._places = [names.index("x"), names.index("y" if self._flat else "z")]
        self._angle = next((index for index, name in enumerate(names) if name in ANGLES), None)
        self._state, self._command = start.copy(), self.idle
        self._put()

    def act(self, command: Array) -> None:  # noqa: D102 - see Body
        self._command = command
        self._state = advance(self._system, self._state, command, self._step)
        self._put()

    def _put(self) -> None:
        x, second, angle = self.pose().tolist()
        self._disc.put(x, second, angle if self._flat else -angle)

    def state(self) -> Array | None:  # noqa: D102
        return self._state.copy()

    def pose(self) -> Array:  # noqa: D102
        return self._of(self._state)

    def velocity(self) -> Array:  # noqa: D102
        return self._of(self._system.dynamics(self._state, self._command))

    def _of(self, values: Array) -> Array:
        """Extract the pose components (3,) from a state or from its derivative."""
        x, second = values[self._places]
        return np.array((x, second, 0.0 if self._angle is None else values[self._angle]))

    def quaternion(self) -> tuple[float, float, float, float]:  # noqa: D102
        half = 0.5 * float(self.pose()[2])
        return (0.0, 0.0, math.sin(half), math.cos(half)) if self._flat else (0.0, math.sin(half), 0.0, math.cos(half))

    def sensor(self) -> SensorPose:  # noqa: D102
        x, second, angle = self.pose().tolist()
        c, s = math.cos(angle), math.sin(angle)
        if self._flat:
            return SensorPose(np.array((x, second, LIDAR_HEIGHT)), np.array(((c, s, 0.0), (-s, c, 0.0))))
        return SensorPose(np.array((x, 0.0, second)), np.array(((c, 0.0, -s), (s, 0.0, c))))

    def wheel_angles(self) -> tuple[float, float] | None:  # noqa: D102
        return None

    def top_speed(self, horizon: float) -> float:  # noqa: ARG002, D102 - not known: it is judged at each step
        return math.inf
