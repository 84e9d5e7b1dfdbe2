"""The policy of a team whose work arrives: it follows each task by what its robot reports, and assigns the next one.

What has happened is derived from a robot's own count of deliveries and from whether it carries a parcel, compared with
its count when the task was assigned. Both outlive the robot's process, and each change of a task is on disk before the
option that follows from it is granted. Repeating a decision after a crash therefore changes nothing.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from option_coordinator.navigation.planner import ReactivePlanner
from option_coordinator.options.options import PolicyQuery
from option_coordinator.policies.joint_policy import JointOptions
from option_coordinator.teams.team_file import OBSERVED, TeamFile, Work
from option_coordinator.work.assignment import FreeRobot, assign
from option_coordinator.work.task import Change, TaskState
from option_coordinator.work.travel import Place, TravelTimes
from option_coordinator.work.work_queue import WorkQueue

_AT_HOME = 2.0 * ReactivePlanner.arrived
_SOME = 50
"""Number of tasks to consider besides one for each free robot: robots wait for the decision."""
_MOST_BARRED = 2
"""Decisions in a row in which a robot may not go to a task's destination, after which the task has failed: an option
that overran is withheld once only, one that overran too often for ever."""


class Dispatcher:
    """Chooses options as a coordinator's policy does, see `PolicyFn`.

    Args:
        team: The team, whose robots deliver as long as there is work.
        queue: Its tasks.
        now: Returns the time of the tasks [s].

    Attributes:
        strays: Number of parcels on board without a task, since the start.
    """

    def __init__(self, team: TeamFile, queue: WorkQueue, now: Callable[[], float]) -> None:
        self._team, self._queue, self._now = team, queue, now
        self._travel = TravelTimes(team)
        self._options = team.option_names
        self._index = {name: index for index, name in enumerate(self._options)}
        self._barred: Counter[str] = Counter()
        self._recalled: set[tuple[str, str]] = set()
        self._lost_since: dict[str, float] = {}
        self.strays = 0

    def __call__(self, query: PolicyQuery) -> tuple[JointOptions, float]:
        """Return the options (N,) of a decision; their log-probability is 0.

        Raises:
            OptionError: The tasks cannot be written: nothing has changed then.
        """
        options, now = query.running.copy(), self._now()
        seen = query.observation.reshape(-1, len(OBSERVED))
        with self._queue.transaction():
            free = {}
            for index, name in enumerate(self._team.robots):
                if query.choosing[index]:
                    legal = {self._options[i] for i in np.flatnonzero(query.legal[index, : len(self._options)])}
                    place = (float(seen[index, 0]), float(seen[index, 1]))
                    option = self._go_on(name, bool(seen[index, 2]), int(seen[index, 3]), legal, now)
                    options[index] = self._index[option or self._idle(name, place, legal)]
                    if option is None:
                        free[name] = self._free(name, place, legal), index
            heading = Counter(self._options[option] for option in options if option >= 0)
            robots = [robot for robot, _ in free.values()]
            for change, robot in assign(self._waiting(robots), robots, self._travel, now, heading):
                index = free[robot.name][1]
                delivered = int(seen[index, 3])
                self._queue.move(change.task.id, TaskState.ASSIGNED, now, robot.name, base=delivered)
                options[index] = self._index[change.task.origin]
        return options, 0.0

    def supervise(self, given_up: Mapping[str, str], lost: Iterable[str]) -> None:
        """End or return what cannot go on.

        A lost robot may still be at it: its task goes to others only after the maximum duration of the option to fetch,
        at which the robot itself would have stopped. A parcel on board remains its own.

        Args:
            given_up: Why robots get no more options, by name.
            lost: Names of robots that have not been heard for long.

        Raises:
            OptionError: The tasks cannot be written.
        """
        now = self._now()
        self._lost_since = {name: self._lost_since.get(name, now) for name in lost}
        with self._queue.transaction():
            for change in self._queue.held():
                robot, fetches = change.robot, change.state is TaskState.ASSIGNED
                silent, longest = now - self._lost_since.get(robot, now), self._team.options[change.task.origin].longest
                if robot in given_up:
                    state = TaskState.WAITING if fetches else TaskState.FAILED
                    self._queue.move(change.task.id, state, now, reason=given_up[robot])
                elif fetches and silent > longest:
                    self._queue.move(change.task.id, TaskState.WAITING, now, reason=f"{robot} is lost")
            for change in self._queue.due(now + self._travel.longest):
                if now + self._travel.of_task(change.task) > change.task.latest:
                    reason = "its latest time can no longer be met: no robot was free early enough"
                    self._queue.move(change.task.id, TaskState.FAILED, now, reason=reason)

    def recalls(self, running: Mapping[str, str]) -> dict[str, str]:
        """Return which robots should stop their option and ask again, and why.

        These are robots on their way to fetch whose task was taken back, and robots on their way home, or waiting
        there, for which there is work. The latter are called once for each task only: what they may fetch now is not
        known before they ask.

        Args:
            running: Names of running options, by robot.
        """
        held = {change.robot for change in self._queue.held()}
        without = {name: self._team.options[option].work for name, option in running.items() if name not in held}
        taken_back = {name: "its task was taken back" for name, work in without.items() if work is Work.FETCH}
        idle = [name for name, work in without.items() if work in (Work.WAIT, Work.REST)]
        origins = set(self._travel.stations(Work.FETCH))
        robots = [self._free(name, self._team.robots[name].home, origins) for name in idle]
        waiting = self._waiting(robots)
        pairs = {(r.name, change.task.id) for change, r in assign(waiting, robots, self._travel, self._now())}
        new, tasks = pairs - self._recalled, {change.task.id for change in waiting}
        self._recalled = {pair for pair in self._recalled | new if pair[1] in tasks}
        return taken_back | {name: "there is work" for name, _ in sorted(new)}

    def _go_on(self, robot: str, carries: bool, delivered: int, legal: set[str], now: float) -> str | None:
        """Record what a robot has done; return the option to go on with, None if it is free."""
        change = self._queue.held_by(robot)
        if change is None and carries:
            change = self._stray(robot, delivered, now)
        if change is None:
            return self._clear(robot, legal) if carries else None
        if change.state is TaskState.ASSIGNED:
            return self._fetches(change, carries, delivered, legal, now)
        return self._delivers(change, carries, delivered, legal, now)

    def _fetches(self, change: Change, carries: bool, delivered: int, legal: set[str], now: float) -> str | None:
        """Go on with an assigned task."""
        if carries or delivered > change.base:
            change = self._queue.move(change.task.id, TaskState.ON_BOARD, now)
            return self._delivers(change, carries, delivered, legal, now)
        forgotten = delivered < change.base
        if change.task.origin in legal and not forgotten:
            return change.task.origin
        reason = f"{change.robot} did not get to '{change.task.origin}' in time"
        if forgotten:
            reason = f"{change.robot} restarted and does not know its work"
        self._queue.move(change.task.id, TaskState.WAITING, now, reason=reason)
        return None

    def _delivers(self, change: Change, carries: bool, delivered: int, legal: set[str], now: float) -> str | None:
        """Go on with a task on board."""
        task = change.task
        if delivered > change.base:
            late = f"{now - task.latest:.0f} s late" if now > task.latest else ""
            self._queue.move(task.id, TaskState.DONE, now, reason=late)
            return None if not carries else self._clear(change.robot, legal)
        if not carries:
            reason = f"{change.robot} no longer has it on board: it restarted and does not know its work"
            self._queue.move(task.id, TaskState.FAILED, now, reason=reason)
            return None
        if task.destination in legal:
            self._barred.pop(task.id, None)
            return task.destination
        self._barred[task.id] += 1
        if self._barred[task.id] < _MOST_BARRED:
            return self._wait(legal)
        del self._barred[task.id]
        reason = f"{change.robot} did not get to '{task.destination}' in time, too often"
        self._queue.move(task.id, TaskState.FAILED, now, reason=reason)
        return self._clear(change.robot, legal)

    def _stray(self, robot: str, delivered: int, now: float) -> Change | None:
        """Return the task of a parcel on board of a robot without a task: its last one, if no other fetched it."""
        last, reason = self._queue.last_of(robot), f"{robot} has it on board"
        if last is not None and last.state is TaskState.ASSIGNED:
            last = self._queue.move(last.task.id, TaskState.WAITING, now, reason=reason)
        if last is None or last.state is not TaskState.WAITING:
            self.strays += 1
            return None
        return self._queue.move(last.task.id, TaskState.ASSIGNED, now, robot, reason, base=delivered)

    def _clear(self, robot: str, legal: set[str]) -> str:
        """Return where to bring a parcel without a task: where its last task goes, else anywhere."""
        last = self._queue.last_of(robot)
        stations = [name for name in self._travel.stations(Work.DELIVER) if name in legal]
        if last is not None and last.task.destination in stations:
            return last.task.destination
        return stations[0] if stations else self._wait(legal)

    def _idle(self, robot: str, place: Place, legal: set[str]) -> str:
        """Return what a robot without a task does: it goes home, out of the others' way, and waits there.

        A robot that has just waited for too long may not wait again at once: it goes home where it is.
        """
        home = [name for name in self._travel.stations(Work.REST) if name in legal]
        wait = self._wait(legal)
        away = math.dist(place, self._team.robots[robot].home) > _AT_HOME
        return home[0] if home and (away or wait not in legal) else wait

    def _waiting(self, robots: Sequence[FreeRobot]) -> list[Change]:
        """Return the waiting tasks that are worth considering for some robots."""
        skills = {""}.union(*(robot.skills for robot in robots))
        return self._queue.waiting(skills, _SOME + len(robots)) if robots else []

    def _wait(self, legal: set[str]) -> str:
        waits = [name for name in self._travel.stations(Work.WAIT) if name in legal]
        return waits[0] if waits else self._team.safe_option

    def _free(self, robot: str, place: Place, legal: set[str]) -> FreeRobot:
        skills = frozenset(self._team.robots[robot].skills)
        return FreeRobot(robot, place, skills, frozenset(self._travel.stations(Work.FETCH)) & legal)
