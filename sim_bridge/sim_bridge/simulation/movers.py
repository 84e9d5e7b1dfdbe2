"""Moving obstacles of a world in one episode."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import MoverPlan
from sim_bridge.engines.engine import Engine

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


class MoverCourse:
    """Motion of one mover along its planned path, with the plan's start, waiting for robots, and jump to the start.

    Attributes:
        plan: Plan of the mover.
        position: Position of the mover [m].
        velocity: Velocity in the last step [m/s].
    """

    def __init__(self, plan: MoverPlan, rate: int, robot_radius: float) -> None:
        """Put the mover at the start of its path.

        Args:
            plan: Path, speed and size.
            rate: Steps per second [Hz].
            robot_radius: Radius of a circle that encloses a robot [m].
        """
        self.plan, self._rate = plan, rate
        self.position, self.velocity = plan.motion.position(0.0), _STILL
        self._least = plan.radius + robot_radius + (plan.yields or 0.0)
        self._steps, self._started = 0, False  # steps since its start

    def advance(self, time: float, robots: Sequence[Pair], top_speed: float) -> Pair:
        """Move by one step, and return the step's start position [m], which follows a jump if there is one.

        Args:
            time: Time since the start of the episode [s].
            robots: Positions of the robots [m].
            top_speed: Maximum speed; twice that is a jump [m/s].
        """
        plan, here = self.plan, self.position
        if not self._started:
            near = plan.near is None or any(math.dist(here, robot) < plan.near for robot in robots)
            self._started = time >= plan.delay and near
        there = plan.motion.position((self._steps + 1) / self._rate) if self._started else here
        if plan.yields is not None and self._blocked(there, robots):
            there = here
        elif self._started:
            self._steps += 1
        velocity = ((there[0] - here[0]) * self._rate, (there[1] - here[1]) * self._rate)
        if math.hypot(*velocity) > 2.0 * top_speed:  # the motion jumps back to its start
            here, velocity = there, _STILL
        self.position, self.velocity = there, velocity
        return here

    def _blocked(self, there: Pair, robots: Sequence[Pair]) -> bool:
        """Return whether the next step would bring the mover too close to a robot."""
        return any(math.dist(there, robot) < min(self._least, math.dist(self.position, robot)) for robot in robots)


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
        self._engine, self._rate = engine, rate
        self._movers = [MoverCourse(plan, rate, robot_radius) for plan in plans]
        self._bodies = [engine.add_mover(mover.plan.radius, mover.position) for mover in self._movers]
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
        for mover, body in zip(self._movers, self._bodies, strict=True):
            body.move(mover.advance(step / self._rate, places, self.top_speed), mover.velocity)

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
