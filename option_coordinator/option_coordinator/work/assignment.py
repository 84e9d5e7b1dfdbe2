"""Assigns waiting tasks to free robots at the least sum of costs, in seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from option_coordinator.work.task import PRIORITY_S, Change
from option_coordinator.work.travel import Place, TravelTimes

_TIGHT = 120.0
"""Slack before the latest time below which a task becomes more urgent, second by second [s]."""
_LEAVES_AFTER = 5.0
"""Time until a robot has left a station after its work there [s]."""
_IMPOSSIBLE = 1e9


class FreeRobot(NamedTuple):
    """A robot without a task.

    Attributes:
        name: Name of the robot.
        place: Its position [m].
        skills: Its skills.
        origins: Stations at which it may fetch now.
    """

    name: str
    place: Place
    skills: frozenset[str]
    origins: frozenset[str]


def assign(
    tasks: Sequence[Change],
    robots: Sequence[FreeRobot],
    travel: TravelTimes,
    now: float,
    heading: Mapping[str, int] | None = None,
) -> list[tuple[Change, FreeRobot]]:
    """Return which robot gets which task: as many as possible, at the least sum of costs.

    A robot's cost of a task is its travel time to the origin, and the time for which others on their way there occupy
    it; less the time that the task has waited, a minute for each step of priority, and what its slack lacks to two
    minutes. A task that waits therefore goes first at last, whatever arrives after it.

    Args:
        tasks: Waiting tasks, in any order.
        robots: Free robots. Ties depend on their order, and on priority, submission and id of the tasks, alone.
        travel: Travel times of the team.
        now: Time [s].
        heading: Number of other robots on their way to each station, by name.
    """
    if not tasks or not robots:
        return []
    tasks = sorted(tasks, key=lambda change: (-change.task.priority, change.submitted, change.task.id))
    costs = _costs(tasks, robots, travel, now, heading or {})
    rows, columns = linear_sum_assignment(costs)
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return [(tasks[column], robots[row]) for row, column in pairs if costs[row, column] < _IMPOSSIBLE]


def _costs(
    tasks: Sequence[Change], robots: Sequence[FreeRobot], travel: TravelTimes, now: float, heading: Mapping[str, int]
) -> NDArray[np.float64]:
    """Return the cost of each task for each robot [s] (robots, tasks); `_IMPOSSIBLE` if it must not have it."""
    origins = sorted({change.task.origin for change in tasks})
    at = [origins.index(change.task.origin) for change in tasks]
    way = np.array([[travel.to_station(robot.place, origin) for origin in origins] for robot in robots])[:, at]
    queueing = np.array([(travel.work_at(name) + _LEAVES_AFTER) * heading.get(name, 0) for name in origins])[at]
    served = np.array([travel.of_task(change.task) for change in tasks])
    earliest = np.array([change.task.earliest for change in tasks])
    slack = np.array([change.task.latest for change in tasks]) - (now + way + served)
    gained = np.array([now - change.submitted + PRIORITY_S * change.task.priority for change in tasks])
    costs = way + queueing - gained - np.clip(_TIGHT - slack, 0.0, None)
    possible = (now + way >= earliest) & (slack >= 0.0) & _able(tasks, robots)
    return np.where(possible, costs, _IMPOSSIBLE)


def _able(tasks: Sequence[Change], robots: Sequence[FreeRobot]) -> NDArray[np.bool_]:
    """Return whether each robot may fetch each task and has the skill for it (robots, tasks)."""
    wants = [(change.task.origin, change.task.skill) for change in tasks]
    return np.array(
        [[origin in r.origins and (not skill or skill in r.skills) for origin, skill in wants] for r in robots]
    )
