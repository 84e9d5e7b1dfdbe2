"""A delivery team's light world, to learn in: points that drive straight, with the real robots' options and rewards.

What a robot does with an option, what it tells and what it earns is `Delivery`, which runs on the real ones too.
Driving is simplified: who has another robot near ahead of it is slower, which stands for getting out of the way.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from option_coordinator.delivery import Delivery
from option_coordinator.options import Agent, Mask, Observation, Scene, SimulationStep
from option_coordinator.robot_side import Seen
from option_coordinator.team_file import TeamFile, Work

_MARGIN = 0.5


class TeamDeliverySimulation:
    """The world of a team file. A robot that has ended its work stays at home and has no other option than that."""

    observes_while_running = False
    """As with real robots: a request tells what its robot sees."""

    def __init__(self, team: TeamFile) -> None:
        self.team = team
        self.agents: tuple[Agent, ...] = tuple(robot.agent for robot in team.coordinated)
        self.time_step = team.time_step
        self.step_limit = round(team.light.episode / team.time_step)
        self._rest = np.array([option.work is Work.REST for option in team.options.values()])
        self.reset(np.random.default_rng(0))

    @property
    def room(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """What holds all stations and homes [m]."""
        x, y = np.transpose(list(self.landmarks.values()))
        return (x.min() - _MARGIN, x.max() + _MARGIN), (y.min() - _MARGIN, y.max() + _MARGIN)

    @property
    def landmarks(self) -> Mapping[str, tuple[float, float]]:
        """Stations and homes [m]."""
        stations = {name: option.station for name, option in self.team.options.items() if option.station is not None}
        return stations | {f"home of {name}": robot.home for name, robot in self.team.robots.items()}

    def reset(self, generator: np.random.Generator) -> None:
        """Begin an episode near home."""
        homes = np.array([robot.home for robot in self.team.robots.values()])
        scatter = self.team.light.scatter
        self._positions = homes + generator.uniform(-scatter, scatter, homes.shape)
        self._work = [Delivery(self.team, name) for name in self.team.robots]
        self._at_home = [False] * len(homes)
        self._steps = 0

    def begin(self, agent: int, option: int) -> None:
        """Let a robot begin an option."""
        self._work[agent].begin(option, self._now)

    def interrupt(self, agent: int) -> None:
        """Take its option from a robot, which stays where it is."""
        self._work[agent].leave(self._now)

    def step(self) -> SimulationStep:
        """Let a time step pass."""
        self._steps += 1
        before = [work.delivered for work in self._work]
        busy = [work.option is not None and not home for work, home in zip(self._work, self._at_home, strict=True)]
        ended = tuple(self._carry_on(agent) for agent in range(len(self.agents)))
        deliveries = sum(work.delivered for work in self._work) - sum(before)
        reward = sum(busy) * self.team.rewards.step + deliveries * self.team.rewards.delivery
        return SimulationStep(reward, ended, all(self._at_home))

    def observe(self, agent: int) -> Observation:
        """Return what a robot tells, see `team_file.OBSERVED`."""
        return self._see(agent).observation

    def legal(self, agent: int) -> Mask:
        """Return which options make sense."""
        return self._rest.copy() if self._at_home[agent] else np.asarray(self._see(agent).legal, dtype=bool)

    def scene(self) -> Scene:
        """Return what a picture needs."""
        places = {a.name: (float(x), float(y)) for a, (x, y) in zip(self.agents, self._positions, strict=True)}
        carried = [a.name for a, work in zip(self.agents, self._work, strict=True) if work.carries]
        delivered = sum(work.delivered for work in self._work)
        return Scene(places, f"{delivered} parcels delivered; {', '.join(carried) or 'nobody'} carries one")

    def figures(self) -> dict[str, Any]:
        """Return how long it took and how many parcels have arrived."""
        return {"makespan": self._now, "deliveries": sum(work.delivered for work in self._work)}

    @property
    def _now(self) -> float:
        return self._steps * self.time_step

    def _see(self, agent: int) -> Seen:
        return self._work[agent].see(np.append(self._positions[agent], 0.0))

    def _carry_on(self, agent: int) -> bool:
        """Let a robot go on with its option, and return whether that has ended."""
        work = self._work[agent]
        option = work.option
        if option is None or not self._arrive(agent, work.place) or work.at_place(self._now) is None:
            return False
        self._at_home[agent] = self._at_home[agent] or work.over(option)
        return True

    def _arrive(self, agent: int, place: tuple[float, float] | None) -> bool:
        """Drive towards a place, and return whether the robot was there before."""
        if place is None:
            return True
        here, light = self._positions[agent], self.team.light
        x, y = place[0] - here[0], place[1] - here[1]
        distance = math.hypot(x, y)
        if distance == 0.0:
            return True
        length = light.speed * self.time_step * (light.slowed if self._is_hindered(agent, x, y) else 1.0)
        self._positions[agent] = place if distance <= length else here + length / distance * np.array((x, y))
        return False

    def _is_hindered(self, agent: int, x: float, y: float) -> bool:
        """Return whether another robot is near in a direction."""
        here = self._positions[agent]
        for other, there in enumerate(self._positions):
            dx, dy = there[0] - here[0], there[1] - here[1]
            if other != agent and dx * x + dy * y > 0.0 and math.hypot(dx, dy) < self.team.light.berth:
                return True
        return False
