"""What stands and moves around robots in roll-outs: walls of a file or of each episode, and movers by a task's law."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from ctrl_rl_core.policies import ScanPart
from numpy.typing import NDArray
from sim_bridge.engines import shape_row
from sim_bridge.fleet import scans
from sim_bridge.simulation import MoverCourse

from ctrl_rl_core import Disc, MoverPlan, NavigationTask, Outcome, TaskSets, World
from ctrl_rl_learning.offline.data.motion import displaced

Array = NDArray[np.float64]
Index = NDArray[np.intp]
_MOVER_RATE = 10.0
"""Steps of movers in a second, about [Hz]."""


class Surroundings:
    """Walls and movers of episodes side by side.

    Args:
        task: Task of the episodes.
        worlds: Walls.
        of: Index of each episode's world; by default one world per episode, or the only one for all.
        plans: Movers of each episode; none unless given.

    Attributes:
        mover_steps: Steps of the movers in a step of the task; 0 without movers.
    """

    def __init__(
        self,
        task: NavigationTask,
        worlds: Sequence[World],
        of: Index | None = None,
        plans: Sequence[Sequence[MoverPlan]] = (),
    ) -> None:
        self._sets, self._of = [TaskSets(task, world=world) for world in worlds], of
        self._shapes = [np.array([shape_row(each) for each in (*world.walls, *world.obstacles)]) for world in worlds]
        self._radius, period = task.robot.radius, task.episode.time_step
        moving = any(plans)
        self.mover_steps = max(1, round(period * _MOVER_RATE)) if moving else 0
        rate = round(self.mover_steps / period)
        self._movers = [[MoverCourse(plan, rate, self._radius) for plan in each] for each in plans] if moving else []
        self._top_speed = max((plan.motion.top_speed for each in plans for plan in each), default=0.0)
        self._time = 0.0

    def ranges(self, which: Index, lidars: Array, part: ScanPart) -> Array:
        """Return the ranges (n, beams) [m] of lidars (n, 3) in episodes (n,), +inf for nothing."""
        out = np.empty((len(lidars), part.count))
        for number, rows in self._by_world(which):
            found = np.empty((len(lidars[rows]), part.count))
            scans(self._shapes[number], lidars[rows], part.bearings, part.high, found)
            out[rows] = found
        return np.minimum(out, self.mover_ranges(which, lidars, part)) if self._movers else out

    def mover_ranges(self, which: Index, lidars: Array, part: ScanPart) -> Array:
        """Return the ranges (n, beams) [m] to movers alone, +inf for none."""
        out = np.full((len(lidars), part.count), np.inf)
        for row, episode in enumerate(which.tolist()):
            discs = [shape_row(Disc(mover.position, mover.plan.radius)) for mover in self._movers[episode]]
            scans(np.array(discs), lidars[row : row + 1], part.bearings, part.high, out[row : row + 1])
        return out

    def outcomes(self, which: Index, states: Array) -> NDArray[np.int64]:
        """Return the outcomes (n,) at states (n, 3) of episodes (n,); who touches a wall or a mover has collided."""
        out = np.empty(len(states), dtype=np.int64)
        for number, rows in self._by_world(which):
            out[rows] = self._sets[number].outcomes(states[rows])
        if self._movers:
            for row, episode in enumerate(which.tolist()):
                place = (float(states[row, 0]), float(states[row, 1]))
                if any(math.dist(place, m.position) < m.plan.radius + self._radius for m in self._movers[episode]):
                    out[row] = Outcome.COLLISION
        return out

    def clearance(self, which: Index, states: Array) -> Array:
        """Return the distance (n,) [m] from the robot at states (n, 3) to the walls of episodes (n,)."""
        out = np.empty(len(states))
        for number, rows in self._by_world(which):
            out[rows] = self._sets[number].clearance(states[rows])
        return out

    def advance(self, which: Index, states: Array) -> None:
        """Let the movers of episodes (n,) move by one of their steps; robots are at states (n, 3)."""
        for row, episode in enumerate(which.tolist()):
            robots = [(float(states[row, 0]), float(states[row, 1]))]
            for mover in self._movers[episode]:
                mover.advance(self._time, robots, self._top_speed)

    def tick(self, period: float) -> None:
        """Let time [s] go on for all episodes."""
        self._time += period

    def _by_world(self, which: Index) -> Iterator[tuple[int, slice | Index]]:
        """Yield the number of each world with the rows in it."""
        if len(self._sets) == 1:
            yield 0, slice(None)
            return
        numbers = which if self._of is None else self._of[which]
        for number in np.unique(numbers).tolist():
            yield number, np.flatnonzero(numbers == number)


def on_the_way(states: Array, moved: Array, apart: float, pieces: int) -> Iterator[Array]:
    """Yield states (n, 3) on the way of displacements (n, 3), at most `apart` [m] apart, in a multiple of pieces."""
    count = max(1, math.ceil(float(np.abs(moved[:, 0]).max()) / apart))
    count = count if not pieces else pieces * math.ceil(count / pieces)
    for number in range(count):
        yield displaced(states, (number + 1) / count * moved)
