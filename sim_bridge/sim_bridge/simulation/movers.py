"""Moving obstacles of a world in one episode."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import MoverPlan
from sim_bridge.engines.engine import Engine, MovingDisc

Array = NDArray[np.float64]
Pair = tuple[float, float]
_STILL: Pair = (0.0, 0.0)


@dataclass(frozen=True)
class MoverStates:
    """Positions and velocities of the movers, in task-file order.

    Attributes:
        positions: Positions of the centres (m, 2) [m].
        velocities: Velocities (m, 2) [m/s].
        radii: Radii (m,) [m].
    """

    positions: Array
    velocities: Array
    radii: Array


@dataclass
class _Mover:
    plan: MoverPlan
    body: MovingDisc
    position: Pair
    velocity: Pair = _STILL
    steps: int = 0  # physics steps since its start
    started: bool = False


class Movers:
    """Moves a world's movers along their planned paths, step by step.

    Attributes:
        top_speed: Upper bound of the movers' speeds [m/s].
    """

    def __init__(self, engine: Engine, plans: Sequence[MoverPlan], rate: int, robot_radius: float) -> None:
        """Place the movers at the start of their paths.

        Args:
            engine: Engine to which the movers are added.
            plans: Paths, speeds and sizes of the movers.
            rate: Physics steps per second [Hz].
            robot_radius: Radius of a circle that encloses a robot [m].
        """
        self._engine, self._rate, self._robot_radius = engine, rate, robot_radius
        self._movers = []
        for plan in plans:
            position = plan.motion.position(0.0)
            self._movers.append(_Mover(plan, engine.add_mover(plan.radius, position), position))
        self.top_speed = max((plan.motion.top_speed for plan in plans), default=0.0)
        self._look = any(plan.near is not None or plan.yields is not None for plan in plans)

    def __len__(self) -> int:
        """Return the number of movers."""
        return len(self._movers)

    def advance(self, step: int, robots: Callable[[], list[Pair]]) -> None:
        """Set the movers' velocities for the next physics step.

        Args:
            step: Physics steps since the start of the episode.
            robots: Function that returns the robots' positions [m].
        """
        places = robots() if self._look else []
        for mover in self._movers:
            self._advance(mover, step / self._rate, places)

    def _advance(self, mover: _Mover, time: float, robots: Sequence[Pair]) -> None:
        plan, here = mover.plan, mover.position
        if not mover.started:
            near = plan.near is None or any(math.dist(here, robot) < plan.near for robot in robots)
            mover.started = time >= plan.delay and near
        there = plan.motion.position((mover.steps + 1) / self._rate) if mover.started else here
        if plan.yields is not None and self._blocked(mover, there, plan.yields, robots):
            there = here
        elif mover.started:
            mover.steps += 1
        velocity = ((there[0] - here[0]) * self._rate, (there[1] - here[1]) * self._rate)
        if math.hypot(*velocity) > 2.0 * self.top_speed:  # the motion jumps back to its start
            here, velocity = there, _STILL
        mover.body.move(here, velocity)
        mover.position, mover.velocity = there, velocity

    def _blocked(self, mover: _Mover, there: Pair, gap: float, robots: Sequence[Pair]) -> bool:
        """Return whether moving on would bring a mover too close to a robot."""
        least = mover.plan.radius + self._robot_radius + gap
        return any(math.dist(there, robot) < min(least, math.dist(mover.position, robot)) for robot in robots)

    def states(self) -> MoverStates:
        """Return the current positions and velocities."""
        return MoverStates(
            np.array([mover.position for mover in self._movers]).reshape(-1, 2),
            np.array([mover.velocity for mover in self._movers]).reshape(-1, 2),
            np.array([mover.plan.radius for mover in self._movers]),
        )

    def hold(self, place: Array) -> bool:
        """Return whether a position (2,) [m] is inside a mover."""
        states = self.states()
        return bool((np.linalg.norm(states.positions - place, axis=1) < states.radii).any())

    def touching(self, robot: int, reach: float) -> int | None:
        """Return the index of a mover that a robot touches or is within `reach` [m] of, or None."""
        distances = [self._engine.mover_distance(robot, number, reach) for number in range(len(self))]
        return int(np.argmin(distances)) if distances and min(distances) < reach else None
