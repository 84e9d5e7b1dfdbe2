"""A light simulation of a delivery team for learning: the robots' own `Delivery` and `Steering`, no physics.

Robots are discs that move exactly as commanded. Each one observes the outlines of walls, obstacles and other robots,
like a lidar.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Disc, draw_starts, load_navigation_task
from option_coordinator.navigation.planner import ReactivePlanner, outline
from option_coordinator.navigation.steering import Steering
from option_coordinator.options.options import Agent, Mask, Observation, Scene, SimulationStep
from option_coordinator.teams.delivery import Delivery
from option_coordinator.teams.team_file import TeamFile, Work

Array = NDArray[np.float64]

_RADIUS = 0.1


class TeamDeliverySimulation:
    """The world of a team file. A robot that has finished its work stays at home, its only remaining option."""

    observes_while_running = False
    """True, because real robots also send their observation with each request."""

    def __init__(self, team: TeamFile) -> None:
        self.team = team
        self.agents: tuple[Agent, ...] = tuple(robot.agent for robot in team.coordinated)
        self.time_step = team.time_step
        self.step_limit = round(team.learning.episode / team.time_step)
        self._task = load_navigation_task(team.room_file)
        self._system = self._task.system.build()
        self._world = self._task.build_world()
        self._outlines = np.concatenate([outline(shape) for shape in (*self._world.walls, *self._world.obstacles)])
        self._planner = ReactivePlanner()
        self._rest = np.array([option.work is Work.REST for option in team.options.values()])
        self._longest = [option.longest for option in team.options.values()]
        self.reset(np.random.default_rng(0))

    @property
    def room(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Extent of walls and obstacles in x and in y [m]."""
        (left, bottom), (right, top) = self._outlines.min(axis=0), self._outlines.max(axis=0)
        return (float(left), float(right)), (float(bottom), float(top))

    @property
    def landmarks(self) -> Mapping[str, tuple[float, float]]:
        """Stations and homes [m]."""
        stations = {name: option.station for name, option in self.team.options.items() if option.station is not None}
        return stations | {f"home of {name}": robot.home for name, robot in self.team.robots.items()}

    def reset(self, generator: np.random.Generator) -> None:
        """Start an episode at the room's start state."""
        self._poses = np.array(
            draw_starts(self._task, self._system, self._world, len(self.agents), self._task.robot.radius, generator)
        )
        self._work = [Delivery(self.team, name) for name in self.team.robots]
        self._steering = [Steering(self._planner, rank) for rank in range(len(self.agents))]
        self._began = [0.0] * len(self.agents)
        self._at_home = [False] * len(self.agents)
        self._steps = 0

    def begin(self, agent: int, option: int) -> None:
        """Start a robot's option."""
        self._began[agent] = self._now
        self._work[agent].begin(option, self._now)

    def interrupt(self, agent: int) -> None:
        """Stop a robot's option; the robot stays where it is."""
        self._work[agent].leave(self._now)

    def step(self) -> SimulationStep:
        """Advance by a time step."""
        self._steps += 1
        delivered = self._delivered
        busy = [work.option is not None and not home for work, home in zip(self._work, self._at_home, strict=True)]
        ended = tuple(self._carry_on(agent) for agent in range(len(self.agents)))
        rewards = self.team.rewards
        reward = sum(busy) * rewards.step + (self._delivered - delivered) * rewards.delivery
        return SimulationStep(reward, ended, all(self._at_home))

    def observe(self, agent: int) -> Observation:
        """Return a robot's observation, see `team_file.OBSERVED`."""
        return self._work[agent].see(self._poses[agent]).observation

    def legal(self, agent: int) -> Mask:
        """Return the sensible options."""
        return self._rest.copy() if self._at_home[agent] else self._work[agent].see(self._poses[agent]).legal

    def scene(self) -> Scene:
        """Return the scene to draw."""
        places = {agent.name: (float(x), float(y)) for agent, (x, y, _) in zip(self.agents, self._poses, strict=True)}
        carry = [agent.name for agent, work in zip(self.agents, self._work, strict=True) if work.carries]
        return Scene(places, f"{self._delivered} parcels delivered; {', '.join(carry) or 'nobody'} carries one")

    def figures(self) -> dict[str, Any]:
        """Return the duration and the number of parcels delivered."""
        return {"makespan": self._now, "deliveries": self._delivered}

    @property
    def _now(self) -> float:
        return self._steps * self.time_step

    @property
    def _delivered(self) -> int:
        return sum(work.delivered for work in self._work)

    def _carry_on(self, agent: int) -> bool:
        """Advance a robot's option; return whether it has ended."""
        work = self._work[agent]
        option, place = work.option, work.place
        if option is None:
            return False
        if place is not None and not self._planner.there(self._poses[agent], place):
            self._drive(agent, place)
            too_long = self._now - self._began[agent] >= self._longest[option]
            if too_long:
                work.leave(self._now)
            return too_long
        if work.at_place(self._now) is None:
            return False
        self._at_home[agent] = self._at_home[agent] or work.over(option)
        return True

    def _drive(self, agent: int, place: tuple[float, float]) -> None:
        x, y, heading = pose = self._poses[agent]
        speed, turn = self._steering[agent].command(pose, self._seen_by(agent), place, self._now)
        middle = heading + 0.5 * turn * self.time_step
        length = speed * self.time_step
        self._poses[agent] = (x + length * np.cos(middle), y + length * np.sin(middle), heading + turn * self.time_step)

    def _seen_by(self, agent: int) -> Array:
        """Return the obstacles near a robot as points (n, 2) [m]."""
        others = np.delete(self._poses[:, :2], agent, axis=0)
        points = np.concatenate((self._outlines, (others[:, None] + _ROBOT).reshape(-1, 2)))
        far = np.abs(points - self._poses[agent, :2]).max(axis=1)
        return points[far < self._planner.look_ahead + _RADIUS]


_ROBOT = outline(Disc((0.0, 0.0), _RADIUS))
