"""Water Filling (thesis 5.3.1): a slow vehicle that can fill jars and a fast drone that can only inspect them.

A light simulation with the published constants: robots move over the cells of an empty room, along the axis with the
larger remaining distance; a robot reads every jar within its reach. In each step the water level falls first, then the
robots move and fill, then jars are read and the reward is computed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import WaterFilling
from option_coordinator.options.options import Agent, Mask, Observation, Scene, SimulationStep

OptionSet = Literal["published", "thesis", "actions"]
Sight = Literal["features", "image"]
VEHICLE, DRONE = range(2)
_STEPS = {"Up": (0, 1), "Down": (0, -1), "Left": (-1, 0), "Right": (1, 0)}
_MEAN_OPTION_STEPS = 3
"""Approximate low-level steps per asynchronous option step; 200 of these give all methods one episode length."""


class Action(NamedTuple):
    """Effect of an option.

    Attributes:
        move: Cells in x and y for a one-step move; None for other options.
        jar: Index of the jar concerned; None for none.
        goes: Whether the robot drives to the jar.
        fills: Whether the robot fills the jar, or without `jar` all jars in reach.
    """

    move: tuple[int, int] | None
    jar: int | None
    goes: bool
    fills: bool


class WaterFillingSimulation:
    """The world of Water Filling.

    Args:
        task: Water Filling task to simulate.
        options: Option set: "published" (7 x 7: NavToFill or NavTo, and one-step moves), "thesis" (Table 5.1: the
            vehicle also fills and navigates separately) or "actions" (one step each: moves and, for the vehicle, Fill).
        sight: Observation besides the shared levels and ages: "features" (position, jars in reach) or "image" (top view
            of the room: the robot in red, the other one in green, jars in blue, with their level as brightness if in
            reach and half brightness otherwise).
    """

    observes_while_running = True
    """True, because the robots share their knowledge of the jars and their images, which are always current."""

    def __init__(self, task: WaterFilling, options: OptionSet = "published", sight: Sight = "features") -> None:
        self.task = task
        self.sight = sight
        (x_low, x_high), (y_low, y_high) = task.room
        self.room = ((x_low, x_high), (y_low, y_high))
        self.time_step = task.time_step
        self.step_limit = _MEAN_OPTION_STEPS * task.episode_option_steps
        self._jars = np.array([jar.position for jar in task.jars])
        self._cells = [round((high - low) / task.cell) + 1 for low, high in self.room]
        self._speed = [round(speed * task.time_step / task.cell) for speed in (task.vehicle_speed, task.drone_speed)]
        count = len(task.jars)
        size = 3 * math.prod(self._cells) if sight == "image" else 2 + count
        self.agents = tuple(
            Agent(name, names, size + 2 * count)
            for name, names in zip(("vehicle", "drone"), _option_names(task, options), strict=True)
        )
        jars = [jar.name for jar in task.jars]
        self._actions = [[_action(name, jars) for name in agent.options] for agent in self.agents]
        self.reset(np.random.default_rng(0))

    @property
    def landmarks(self) -> Mapping[str, tuple[float, float]]:
        """Positions of the jars [m], by name."""
        return {jar.name: jar.position for jar in self.task.jars}

    def reset(self, generator: np.random.Generator) -> None:
        """Start an episode with full jars and both robots at the centre."""
        count = len(self.task.jars)
        self._random = generator
        self.levels = np.full(count, self.task.start_level)
        self.known = self.levels.copy()
        self.ages = np.zeros(count)
        self._cell = [[count // 2 for count in self._cells] for _ in self.agents]  # scalars are faster
        self._reach = np.zeros((2, count), dtype=bool)
        for agent in (VEHICLE, DRONE):
            self._look(agent)
        self._running: list[Action | None] = [None, None]
        self._wait = np.zeros(count)
        self._drop = np.zeros(count)
        for jar in range(count):
            self._draw(jar)
        self._fills, self._steps, self._paid = 0, 0, 0.0

    def begin(self, agent: int, option: int) -> None:
        """Start an agent's option."""
        self._running[agent] = self._actions[agent][option]

    def interrupt(self, agent: int) -> None:
        """Stop an agent's option; the agent stays where it is."""
        self._running[agent] = None

    def step(self) -> SimulationStep:
        """Advance by half a second."""
        self._fall()
        ended = (self._act(VEHICLE), self._act(DRONE))
        seen = self._reach.any(axis=0)
        self.known[seen] = self.levels[seen]
        self.ages = np.where(seen, 0.0, self.ages + 1.0 / self.task.episode_option_steps)
        reward = float(np.sum(1.0 - 1.0 / (self.levels + self.task.level_offset)))  # Eq. 5.6
        self._steps += 1
        self._paid += reward
        return SimulationStep(reward, ended, False)

    def observe(self, agent: int) -> Observation:
        """Return the robot's own observation, the last known levels, and the age of each reading [200 steps]."""
        own = self._image(agent) if self.sight == "image" else self._features(agent)
        return np.concatenate((own, self.known, self.ages)).astype(np.float32)

    def legal(self, agent: int) -> Mask:
        """Return the options that an agent may start: no moves into the wall, no filling out of reach."""
        return np.array([self._is_legal(agent, action) for action in self._actions[agent]])

    def scene(self) -> Scene:
        """Return the scene to draw."""
        places = {a.name: tuple(p) for a, p in zip(self.agents, self._positions().tolist(), strict=True)}
        levels = "  ".join(f"{jar.name} {level:.2f}" for jar, level in zip(self.task.jars, self.levels, strict=True))
        return Scene(places, levels)

    def figures(self) -> dict[str, Any]:
        """Return the mean low-level reward and the number of fillings."""
        return {"mean_reward": self._paid / max(self._steps, 1), "fills": self._fills}

    def _is_legal(self, agent: int, action: Action) -> bool:
        if action.move is not None:
            (x, y), (dx, dy), (width, depth) = self._cell[agent], action.move, self._cells
            return 0 <= x + dx < width and 0 <= y + dy < depth
        if action.goes or not action.fills:
            return True
        return bool(self._reach[agent].any() if action.jar is None else self._reach[agent, action.jar])

    def _draw(self, jar: int) -> None:
        """Draw the time and amount of a jar's next drop in level."""
        low, high = self.task.interval_means
        interval = round(self._random.exponential(self._random.integers(low, high + 1)))
        self._wait[jar] = interval
        self._drop[jar] = abs(self._random.normal(interval / self.task.drop_divisor, self.task.drop_deviation))

    def _fall(self) -> None:
        for jar in range(len(self.levels)):
            if self._wait[jar] > 0:
                self._wait[jar] -= 1
            else:
                self.levels[jar] = max(0.0, self.levels[jar] - self._drop[jar])
                self._draw(jar)

    def _act(self, agent: int) -> bool:
        """Advance an agent by one step and return whether its option has ended."""
        action = self._running[agent]
        if action is None:
            return False
        if action.move is not None:
            for axis, direction in enumerate(action.move):
                target = self._cell[agent][axis] + self._speed[agent] * direction
                self._cell[agent][axis] = min(max(target, 0), self._cells[axis] - 1)
            self._look(agent)
        if action.goes and action.jar is not None and not self._approach(agent, action.jar):
            return False
        if action.fills:
            for jar in np.flatnonzero(self._reach[agent]) if action.jar is None else [action.jar]:
                self._fill(int(jar))
        self._running[agent] = None
        return True

    def _approach(self, agent: int, jar: int) -> bool:
        """Move towards a jar and return whether it is within reach."""
        for _ in range(self._speed[agent]):
            if self._reach[agent, jar]:
                return True
            way = self._way(agent, jar)
            axis = int(abs(way[1]) > abs(way[0]))
            self._cell[agent][axis] += 1 if way[axis] > 0.0 else -1
            self._look(agent)
        return bool(self._reach[agent, jar])

    def _way(self, agent: int, jar: int) -> tuple[float, float]:
        """Return the displacement from an agent to a jar (x, y) [m]."""
        (x_low, _), (y_low, _) = self.room
        x, y = self._cell[agent]
        goal = self.task.jars[jar].position
        return goal[0] - (x_low + self.task.cell * x), goal[1] - (y_low + self.task.cell * y)

    def _look(self, agent: int) -> None:
        """Read the jars within an agent's reach."""
        for jar in range(len(self.levels)):
            x, y = self._way(agent, jar)
            self._reach[agent, jar] = x * x + y * y <= self.task.reach**2

    def _fill(self, jar: int) -> None:
        self.levels[jar] = 1.0
        self._fills += 1

    def _positions(self) -> NDArray[np.float64]:
        """Return the robots' positions (2, 2) [m]."""
        low = np.array([client[0] for client in self.room])
        return low + self.task.cell * np.array(self._cell)

    def _features(self, agent: int) -> NDArray[np.float64]:
        return np.concatenate((np.array(self._cell[agent]) / (np.array(self._cells) - 1.0), self._reach[agent]))

    def _image(self, agent: int) -> NDArray[np.float64]:
        """Return the top view of the room, flattened (3 x width x depth,)."""
        image = np.zeros((3, *self._cells))
        image[0][tuple(self._cell[agent])] = 1.0
        image[1][tuple(self._cell[1 - agent])] = 1.0
        low = np.array([client[0] for client in self.room])
        in_reach = self._reach[agent]
        for jar, place in enumerate(np.round((self._jars - low) / self.task.cell).astype(int)):
            image[2][tuple(place)] = self.levels[jar] if in_reach[jar] else 0.5
        return image.ravel()


def _action(name: str, jars: Sequence[str]) -> Action:
    """Return the effect of an option."""
    what, _, jar = name.partition(":")
    return Action(_STEPS.get(what), jars.index(jar) if jar else None, what.startswith("NavTo"), what.endswith("Fill"))


def _option_names(task: WaterFilling, options: OptionSet) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the option names of vehicle and drone."""
    jars = [jar.name for jar in task.jars]
    moves = tuple(_STEPS)
    if options == "actions":
        return (*moves, "Fill"), moves
    look = tuple(f"NavTo:{jar}" for jar in jars)
    fill = tuple(f"NavToFill:{jar}" for jar in jars)
    if options == "published":
        return (*fill, *moves), (*look, *moves)
    return (*moves, *(f"Fill:{jar}" for jar in jars), *look, *fill), (*moves, *look)
