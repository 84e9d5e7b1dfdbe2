"""Tool Delivery (thesis 5.3.1): a Fetchbot and two Turtlebots bring a human the right tools in time.

In each step the Turtlebots act first, then the Fetchbot; then success is checked and the human's clock advances.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from ctrl_rl_core.geometry import Point

from ctrl_rl_core import ToolDelivery
from option_coordinator.options.options import Agent, Mask, Observation, Scene, SimulationStep

GO_TO_WS, GO_TO_TR, GET_TOOL = range(3)
WAIT, PASS_TO_0, PASS_TO_1, SEARCH = range(4)
"""Options of the Fetchbot; `SEARCH` + h searches for tool h."""
WORKSHOP, TOOL_ROOM, TABLE, NOWHERE = range(4)
"""Places of a Turtlebot: the last waypoint reached."""
IDLE = -1


@dataclass
class Turtlebot:
    """State of a Turtlebot.

    Attributes:
        x: Coordinate x of its position [m].
        y: Coordinate y of its position [m].
        waypoints: Positions of workshop, tool room and the robot's own spot at the table [m].
        place: Last waypoint reached, kept while moving.
        option: Current option; `IDLE` for none.
        waited: Number of steps spent waiting at the table for a tool; 0 otherwise.
        basket: Indices of the tools carried.
    """

    x: float
    y: float
    waypoints: tuple[Point, Point, Point]
    place: int = NOWHERE
    option: int = IDLE
    waited: int = 0
    basket: set[int] = field(default_factory=set)

    @property
    def is_at_table(self) -> bool:
        """Whether the robot stands exactly on its spot at the table."""
        return (self.x, self.y) == self.waypoints[TABLE]

    def move(self, waypoint: int, length: float) -> bool:
        """Move one step towards a waypoint; return whether it has been reached."""
        x, y = self.waypoints[waypoint]
        # Rounded as in the published environment, because the optimum of 40 steps depends on it.
        distance = round(float(np.hypot(x - self.x, y - self.y)), 2)
        if distance < length:
            self.x, self.y, self.place = x, y, waypoint
            return True
        self.x += length / distance * (x - self.x)
        self.y += length / distance * (y - self.y)
        return False


@dataclass
class Fetchbot:
    """State of the Fetchbot.

    Attributes:
        option: Current option; `IDLE` for none.
        worked: Number of steps spent on the option.
        in_vain: Whether the Turtlebot was absent when the pass started.
        staged: Found tools waiting to be passed, oldest first.
        found: All tools found so far.
    """

    option: int = IDLE
    worked: int = 0
    in_vain: bool = False
    staged: list[int] = field(default_factory=list)
    found: set[int] = field(default_factory=set)


@dataclass
class Human:
    """The human: consecutive stages of work; every stage but the last needs a tool before the next one can start."""

    stage: int = 0
    left: int = 0
    has_tool: bool = False


class ToolDeliverySimulation:
    """The world of Tool Delivery; options of thesis Table 5.1, with Wait as in the published environment."""

    observes_while_running = False
    """As in the published environment."""

    def __init__(self, task: ToolDelivery) -> None:
        self.task = task
        turtlebot = ("GoToWS", "GoToTR", "GetTool")
        tools = len(task.tools)
        fetchbot = ("Wait", "PassTo0", "PassTo1", *(f"SearchTool{h}" for h in range(tools)))
        self.agents = (
            *(Agent(robot.name, turtlebot, 4 + task.stages + tools + 2) for robot in task.turtlebots),
            Agent(task.fetchbot.name, fetchbot, 4),
        )
        self.step_limit = task.horizon
        self.time_step = task.time_step
        self.room = ((0.0, task.room[0]), (0.0, task.room[1]))
        self.deliveries = self.failed_passes = 0
        self._durations = (task.wait_steps, task.pass_steps, task.pass_steps, *(task.search_steps,) * tools)
        self.reset(np.random.default_rng(0))

    @property
    def landmarks(self) -> Mapping[str, tuple[float, float]]:
        """Workshop, tool room and spots at the table [m]."""
        spots = {f"table {i}": robot.waypoints[TABLE] for i, robot in enumerate(self.turtlebots)}
        return {"workshop": self.task.workshop, "tool room": self.task.tool_room, **spots}

    def reset(self, generator: np.random.Generator) -> None:  # noqa: ARG002 - nothing here is random
        """Start an episode."""
        task = self.task
        self.turtlebots = [
            Turtlebot(*robot.start, (task.workshop, task.tool_room, robot.table_spot))
            for robot in task.turtlebots
            if robot.table_spot is not None
        ]
        self.fetchbot = Fetchbot()
        self.human = Human(left=task.stage_steps)
        self.deliveries = self.failed_passes = 0

    def begin(self, agent: int, option: int) -> None:
        """Start an agent's option."""
        if agent < len(self.turtlebots):
            self.turtlebots[agent].option, self.turtlebots[agent].waited = option, 0
        else:
            self.fetchbot.option, self.fetchbot.worked, self.fetchbot.in_vain = option, 0, False

    def interrupt(self, agent: int) -> None:
        """Stop an agent's option; an unfinished search or pass and the wait at the table are lost."""
        self.begin(agent, IDLE)

    def step(self) -> SimulationStep:
        """Advance by one second."""
        before = self._carried_out()
        reward = self.task.rewards.step
        for robot in self.turtlebots:
            reward += self._drive(robot)
        reward += self._fetch()
        done = self.human.stage == self.task.stages - 2 and self.human.has_tool
        self._work()
        ended = tuple(was != IDLE and now == IDLE for was, now in zip(before, self._carried_out(), strict=True))
        return SimulationStep(reward, ended, done)

    def observe(self, agent: int) -> Observation:
        """Return the observation bits of thesis 5.3.1.

        Turtlebot: place (4), human's stage (only in the workshop), basket, one or two tools staged (not in the
        workshop). Fetchbot: one or two tools staged, presence of each Turtlebot at the table.
        """
        staged = [float(len(self.fetchbot.staged) == n) for n in (1, 2)]
        if agent >= len(self.turtlebots):
            return np.array([*staged, *(float(robot.is_at_table) for robot in self.turtlebots)], dtype=np.float32)
        robot = self.turtlebots[agent]
        place = [float(robot.place == p) for p in range(4)]
        in_workshop = robot.place == WORKSHOP
        stage = [float(in_workshop and self.human.stage == s) for s in range(self.task.stages)]
        basket = [float(tool in robot.basket) for tool in self.task.tools]
        ready = [0.0, 0.0] if in_workshop else staged
        return np.array([*place, *stage, *basket, *ready], dtype=np.float32)

    def legal(self, agent: int) -> Mask:
        """Return the options that an agent may start: always all; a useless one costs time."""
        return np.ones(len(self.agents[agent].options), dtype=bool)

    def scene(self) -> Scene:
        """Return the scene to draw."""
        robots = [(robot.x, robot.y) for robot in self.turtlebots] + [self.task.fetchbot.start]
        baskets = "  ".join(f"{sorted(robot.basket)}" for robot in self.turtlebots)
        has = "has its tool" if self.human.has_tool else f"needs tool {self.human.stage}"
        note = f"stage {self.human.stage}: human {has}; staged {self.fetchbot.staged}, baskets {baskets}"
        return Scene({agent.name: place for agent, place in zip(self.agents, robots, strict=True)}, note)

    def figures(self) -> dict[str, Any]:
        """Return the number of tools delivered in time, and the number of failed passes."""
        return {"deliveries": self.deliveries, "failed_passes": self.failed_passes}

    def _carried_out(self) -> list[int]:
        return [*(robot.option for robot in self.turtlebots), self.fetchbot.option]

    def _drive(self, robot: Turtlebot) -> float:
        """Advance a Turtlebot and return the reward."""
        option = robot.option
        if option == IDLE or not robot.move(option, self.task.step_length):
            return 0.0
        if option == GET_TOOL:
            robot.waited += 1
            if robot.waited >= self.task.table_patience:
                robot.option, robot.waited = IDLE, 0
            return 0.0
        robot.option = IDLE
        return self._hand_over(robot) if option == GO_TO_WS else 0.0

    def _hand_over(self, robot: Turtlebot) -> float:
        human = self.human
        if human.has_tool or human.stage not in robot.basket:
            return 0.0
        robot.basket.remove(human.stage)
        human.has_tool = True
        self.deliveries += 1
        return self.task.rewards.delivery

    def _fetch(self) -> float:
        """Advance the Fetchbot and return the reward."""
        fetchbot = self.fetchbot
        if fetchbot.option == IDLE:
            return 0.0
        passes = fetchbot.option in (PASS_TO_0, PASS_TO_1)
        if passes and fetchbot.worked == 0:
            fetchbot.in_vain = self.turtlebots[fetchbot.option - PASS_TO_0].waited == 0
        fetchbot.worked += 1
        if fetchbot.worked < self._durations[fetchbot.option]:
            return 0.0
        option, fetchbot.option, fetchbot.worked = fetchbot.option, IDLE, 0
        if option >= SEARCH:
            self._stage(option - SEARCH)
        return self._pass(self.turtlebots[option - PASS_TO_0]) if passes else 0.0

    def _pass(self, robot: Turtlebot) -> float:
        if self.fetchbot.in_vain or robot.waited == 0:
            self.failed_passes += 1
            return self.task.rewards.failed_pass
        if self.fetchbot.staged:
            robot.basket.add(self.fetchbot.staged.pop(0))
        robot.option, robot.waited = IDLE, 0
        return 0.0

    def _stage(self, tool: int) -> None:
        if tool not in self.fetchbot.found and len(self.fetchbot.staged) < self.task.staged_tools:
            self.fetchbot.found.add(tool)
            self.fetchbot.staged.append(tool)

    def _work(self) -> None:
        """Advance the human's clock."""
        human = self.human
        human.left -= 1
        if human.left <= 0 and human.has_tool and human.stage < self.task.stages - 1:
            human.stage += 1
            human.left = self.task.stage_steps
            human.has_tool = False
