"""Admission: refuses what nobody of the team can do, with the reason."""

from __future__ import annotations

from option_coordinator.teams.team_file import TeamFile, Work
from option_coordinator.work.task import DELIVERY, Task
from option_coordinator.work.travel import TravelTimes


class Admission:
    """Decides which tasks a team accepts.

    Args:
        team: The team. Loading it has checked that each of its robots has a way to each station to fetch at, and from
            there to each station to deliver at.
    """

    def __init__(self, team: TeamFile) -> None:
        self._team, self._travel = team, TravelTimes(team)

    def refusal(self, task: Task, now: float) -> str:
        """Return why nobody can do a task; empty if somebody can."""
        if task.kind != DELIVERY:
            return f"its kind is {task.kind!r}: team '{self._team.name}' knows '{DELIVERY}' alone"
        for key, name, work in (("origin", task.origin, Work.FETCH), ("destination", task.destination, Work.DELIVER)):
            if name not in self._travel.stations(work):
                return self._no_station(key, name, work)
        skills = {skill for robot in self._team.robots.values() for skill in robot.skills}
        if task.skill and task.skill not in skills:
            known = ", ".join(sorted(skills)) or "none"
            return f"no robot has the skill {task.skill!r}: skills of team '{self._team.name}' are {known}"
        return self._no_time(task, now)

    def _no_station(self, key: str, name: str, work: Work) -> str:
        verb = "fetches" if work is Work.FETCH else "delivers"
        known = ", ".join(self._travel.stations(work))
        option = self._team.options.get(name)
        what = f"there is no station {name!r}" if option is None else f"'{name}' is an option to {option.work.value}"
        return f"its {key}: {what}; team '{self._team.name}' {verb} at {known}"

    def _no_time(self, task: Task, now: float) -> str:
        begin, needed = max(now, task.earliest), self._travel.of_task(task)
        if begin + needed <= task.latest:
            return ""
        left = max(0.0, task.latest - begin)
        way = f"from '{task.origin}' to '{task.destination}'"
        return f"its latest time cannot be met: {way} takes at least {needed:.0f} s, and {left:.0f} s are left"
