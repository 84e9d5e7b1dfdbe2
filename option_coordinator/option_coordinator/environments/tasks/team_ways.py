"""Checks that a team's robots can reach their goals, by simulating the planner for one robot at a time.

The planner heads straight for its goal and drives around small obstacles. It has no map, so a wall between two stations
blocks a robot permanently.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask
from option_coordinator.environments.tasks.team_delivery import outline
from option_coordinator.errors import OptionError
from option_coordinator.navigation.delivery import ReactivePlanner
from option_coordinator.teams.team_file import TeamFile, Work

Place = tuple[float, float]


def check_ways(team: TeamFile, room: NavigationTask) -> None:
    """Raise unless a robot gets from each place of its work to the next within the option's maximum duration.

    Raises:
        OptionError: A robot does not arrive in time; the message names both places.
    """
    world, planner = room.build_world(), ReactivePlanner()
    walls = np.concatenate([outline(shape) for shape in (*world.walls, *world.obstacles)])
    for (start, here), (goal, there), longest in _ways(team):
        if not _arrives(planner, walls, here, there, longest, team.time_step):
            raise OptionError(
                f"in room '{room.name}' a robot does not get from {start} to {goal} within {longest:g} s: it heads "
                "straight for its goal and avoids only small obstacles; move a wall or a station"
            )


def _ways(team: TeamFile) -> Iterator[tuple[tuple[str, Place], tuple[str, Place], float]]:
    """Yield start and goal with their names, and the time limit [s]: fetch to deliver, and on to fetch or home."""

    def of(work: Work) -> list[tuple[tuple[str, Place], float]]:
        each = ((name, option) for name, option in team.options.items() if option.work is work)
        return [((f"'{name}'", option.station), option.longest) for name, option in each if option.station is not None]

    rest = max(option.longest for option in team.options.values() if option.work is Work.REST)
    homes = [((f"the home of {name}", robot.home), rest) for name, robot in team.robots.items()]
    fetch, deliver = of(Work.FETCH), of(Work.DELIVER)
    for (start, _), (goal, longest) in (*product(fetch, deliver), *product(deliver, fetch), *product(deliver, homes)):
        yield start, goal, longest


def _arrives(
    planner: ReactivePlanner, walls: NDArray[np.float64], here: Place, there: Place, longest: float, step: float
) -> bool:
    """Return whether a robot that moves exactly as commanded, starting towards its goal, arrives in time."""
    pose = np.array((*here, math.atan2(there[1] - here[1], there[0] - here[0])))
    for _ in range(math.ceil(longest / step)):
        if planner.there(pose, there):
            return True
        near = walls[np.abs(walls - pose[:2]).max(axis=1) < 2.0 * planner.look_ahead]
        speed, turn = planner.command(pose, near, there)
        middle = pose[2] + 0.5 * turn * step
        pose += (speed * step * math.cos(middle), speed * step * math.sin(middle), turn * step)
    return False
