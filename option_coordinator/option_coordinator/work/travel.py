"""How long a team's robots need at least, as the crow flies: the estimate of admission and assignment."""

from __future__ import annotations

import math
from functools import cached_property
from itertools import product

from option_coordinator.errors import OptionError
from option_coordinator.navigation.planner import ReactivePlanner
from option_coordinator.teams.team_file import NavigationOption, TeamFile, Work
from option_coordinator.work.task import Task

Place = tuple[float, float]


class TravelTimes:
    """Travel and working times of a team [s].

    Args:
        team: The team; loading it has checked that each robot has a way to each station.
    """

    def __init__(self, team: TeamFile) -> None:
        self._team, self._speed = team, ReactivePlanner.speed

    def stations(self, work: Work) -> list[str]:
        """Return the names of the stations with some work, in order."""
        return [name for name, option in self._team.options.items() if option.work is work]

    def between(self, here: Place, there: Place) -> float:
        """Return the travel time between two places."""
        return math.dist(here, there) / self._speed

    def to_station(self, here: Place, station: str) -> float:
        """Return the travel time from a place to a station."""
        return self.between(here, self._place(self._team.options[station]))

    def work_at(self, station: str) -> float:
        """Return the time that the work at a station takes."""
        return self._team.options[station].lasts

    def of_task(self, task: Task) -> float:
        """Return the time of a task from the arrival at its origin on."""
        origin, destination = self._team.options[task.origin], self._team.options[task.destination]
        return origin.lasts + self.between(self._place(origin), self._place(destination)) + destination.lasts

    @cached_property
    def longest(self) -> float:
        """The longest time of any task from the arrival at its origin on."""
        pairs = product(self.stations(Work.FETCH), self.stations(Work.DELIVER))
        return max(self.of_task(Task("any", origin, destination)) for origin, destination in pairs)

    @staticmethod
    def _place(option: NavigationOption) -> Place:
        if option.station is None:
            raise OptionError("an option without a station is not a place")
        return option.station
