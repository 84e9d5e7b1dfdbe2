"""Tool Delivery without options: every agent chooses a low-level action in every step ("end2end", thesis 5.3.2)."""

from __future__ import annotations

import numpy as np

from ctrl_rl_core import ToolDelivery
from option_coordinator.environments.tasks.tool_delivery import (
    GET_TOOL,
    IDLE,
    TABLE,
    WORKSHOP,
    ToolDeliverySimulation,
    Turtlebot,
)
from option_coordinator.options.options import Agent, Observation, SimulationStep

_STEPS = ((-1.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
STAY = len(_STEPS)


class ToolDeliveryActions(ToolDeliverySimulation):
    """Tool Delivery with one-step actions; world, human and rewards are unchanged.

    A Turtlebot moves left, right, up or down by one step length, or stays, which at the table means waiting for a tool;
    it snaps to a waypoint within half a step. The Fetchbot works for one step on the chosen action; choosing another
    one loses the progress. Each agent additionally observes what it needs to act this way: its position, or its current
    work and progress.
    """

    def __init__(self, task: ToolDelivery) -> None:
        super().__init__(task)
        moves = ("Left", "Right", "Up", "Down", "Stay")
        *turtlebots, fetchbot = self.agents
        self.agents = (
            *(Agent(robot.name, moves, robot.observation_size + 2) for robot in turtlebots),
            Agent(fetchbot.name, fetchbot.options, fetchbot.observation_size + len(fetchbot.options) + 1),
        )

    def reset(self, generator: np.random.Generator) -> None:
        """Start an episode."""
        super().reset(generator)
        self._action = [IDLE] * len(self.agents)

    def begin(self, agent: int, option: int) -> None:
        """Start an agent's action; the Fetchbot continues work on the same tool."""
        self._action[agent] = option
        if agent < len(self.turtlebots):
            self.turtlebots[agent].option = option
        elif self.fetchbot.option != option:
            super().begin(agent, option)

    def step(self) -> SimulationStep:
        """Advance by one second, after which every action ends."""
        acted = tuple(action != IDLE for action in self._action)
        self._action = [IDLE] * len(self.agents)
        return super().step()._replace(ended=acted)

    def observe(self, agent: int) -> Observation:
        """Return the observation with options, plus the position, or the work and its progress, scaled to [0, 1]."""
        if agent < len(self.turtlebots):
            robot = self.turtlebots[agent]
            own = [robot.x / self.task.room[0], robot.y / self.task.room[1]]
        else:
            options = range(len(self._durations))
            work = [float(self.fetchbot.option == option) for option in options]
            own = [*work, self.fetchbot.worked / max(self._durations)]
        return np.concatenate((super().observe(agent), np.array(own, dtype=np.float32)))

    def _drive(self, robot: Turtlebot) -> float:
        if robot.option == STAY:
            robot.waited += robot.is_at_table
        else:
            self._move(robot)
        robot.option = GET_TOOL  # represents no option: `_pass` may end it, and it has no time limit
        return self._hand_over(robot) if (robot.x, robot.y) == robot.waypoints[WORKSHOP] else 0.0

    def _move(self, robot: Turtlebot) -> None:
        length, room = self.task.step_length, self.task.room
        x, y = _STEPS[robot.option]
        robot.waited = 0
        robot.x = float(np.clip(robot.x + length * x, 0.0, room[0]))
        robot.y = float(np.clip(robot.y + length * y, 0.0, room[1]))
        for place in range(TABLE + 1):
            waypoint = robot.waypoints[place]
            if max(abs(robot.x - waypoint[0]), abs(robot.y - waypoint[1])) <= 0.5 * length + 1e-9:
                (robot.x, robot.y), robot.place = waypoint, place
