"""Checks that a team's robots reach their goals: clearance and connection on a grid, then each way driven once.

The planner heads straight for its goal and drives around small obstacles. It has no map, so a long wall or a corner
between two stations blocks a robot permanently.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ctrl_rl_core import NavigationTask, World
from option_coordinator.errors import OptionError
from option_coordinator.navigation.planner import Array, ReactivePlanner, outline
from option_coordinator.teams.team_file import TeamFile, Work

Place = tuple[float, float]

_CELL, _MOST_CELLS = 0.05, 400_000
_STRAIGHT_EXTRA = 3.5
"""Time for turning at the start and for the slow last centimetres of a straight way [s]."""
_PATIENCE = 4.0
"""How long a way that takes too long is tried, to say how long it takes [maximum durations]."""
_WIDTHS = 20


class _Way(NamedTuple):
    """A way of a robot: names and positions [m] of both ends, and the option that leads there with its limit [s]."""

    robot: str
    start: str
    here: Place
    goal: str
    there: Place
    option: str
    longest: float


def check_ways(team: TeamFile, room: NavigationTask) -> None:
    """Raise unless each robot gets from its home and from each station to all next places of its work, in time.

    Raises:
        OptionError: A robot has no way, or takes too long; the message names the robot, both ends and a remedy.
    """
    world, planner = room.build_world(), ReactivePlanner()
    ways = list(_ways(team))
    space = _FreeSpace(room, world, {place for way in ways for place in (way.here, way.there)}, planner.clearance)
    walls = np.concatenate([np.empty((0, 2)), *(outline(shape) for shape in (*world.walls, *world.obstacles))])
    for way in ways:
        words = f"{way.robot} has no way from {way.start} to {way.goal} in room '{room.name}'"
        if not space.connects(way.here, way.there, 0.5 * planner.passage):
            width = 2.0 * space.widest(way.here, way.there, 0.5 * planner.passage)
            found = f"the widest is {width:.2g} m wide" if width > 0.0 else "walls or obstacles separate them"
            raise OptionError(
                f"{words}: {found}, its steering needs {planner.passage:g} m; widen the room there or move one "
                "of the two"
            )
        taken = _straight(planner, world, way) or _driven(planner, walls, way, team.time_step)
        if taken is None:
            raise OptionError(
                f"{words} that its steering finds: it heads straight for the goal and goes round small obstacles only; "
                "move the wall between them or one of the two"
            )
        if taken > way.longest:
            raise OptionError(
                f"{way.robot} does not get from {way.start} to {way.goal} in room '{room.name}' within "
                f"{way.longest:g} s: it takes {taken:.0f} s; raise options.{way.option}.longest"
            )


def _ways(team: TeamFile) -> Iterator[_Way]:
    """Yield the ways of all robots: from home to fetch, to deliver, and on to fetch or home."""
    stations = {name: option for name, option in team.options.items() if option.station is not None}
    fetch, deliver = ([n for n, o in stations.items() if o.work is work] for work in (Work.FETCH, Work.DELIVER))
    home, rest = next((name, option) for name, option in team.options.items() if option.work is Work.REST)

    def to(robot: str, start: str, here: Place, name: str) -> _Way:
        station = stations[name].station
        assert station is not None
        return _Way(robot, start, here, f"'{name}'", station, name, stations[name].longest)

    def at(name: str) -> Place:
        station = stations[name].station
        assert station is not None
        return station

    anyone = next(iter(team.robots))
    for start, goal in (*product(fetch, deliver), *product(deliver, fetch)):
        yield to(anyone, f"'{start}'", at(start), goal)
    for robot, start in product(team.robots, (*fetch, *deliver)):
        own = team.robots[robot].home
        if start in fetch:
            yield to(robot, "its home", own, start)
        else:
            yield _Way(robot, f"'{start}'", at(start), "its home", own, home, rest.longest)


class _FreeSpace:
    """The distance of a room's places to walls and obstacles, on a grid.

    Args:
        room: Room of the places.
        world: Its walls and obstacles.
        ends: Ends of ways, around which a smaller clearance suffices.
        clearance: That clearance [m].
    """

    def __init__(self, room: NavigationTask, world: World, ends: Iterable[Place], clearance: float) -> None:
        bounds = list(room.plane_bounds.values())
        area = math.prod(high - low for low, high in bounds)
        self._cell = max(_CELL, math.sqrt(area / _MOST_CELLS))
        self._low = np.array([low for low, _ in bounds])
        axes = [np.arange(low, high + 0.5 * self._cell, self._cell) for low, high in bounds]
        places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        self._clearance = world.signed_distance(places)
        free = self._clearance >= clearance - 0.75 * self._cell
        self._ends = np.zeros(free.shape, bool)
        for end in ends:
            self._ends |= free & (np.linalg.norm(places - end, axis=-1) <= clearance)
        self._regions: dict[float, NDArray[np.signedinteger]] = {}

    def connects(self, here: Place, there: Place, clearance: float) -> bool:
        """Return whether a way between two places has a clearance [m], but for three quarters of a cell."""
        if clearance not in self._regions:
            free = self._ends | (self._clearance >= clearance - 0.75 * self._cell)
            self._regions[clearance] = ndimage.label(free, np.ones((3, 3)))[0]
        regions = self._regions[clearance]
        one, other = regions[self._at(here)], regions[self._at(there)]
        return bool(one == other != 0)

    def widest(self, here: Place, there: Place, clearance: float) -> float:
        """Return the largest clearance of a way between two places [m], below a given one; 0 if there is no way."""
        low, high = 0.0, clearance
        if not self.connects(here, there, 0.75 * self._cell):
            return 0.0
        for _ in range(_WIDTHS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.connects(here, there, middle + 0.75 * self._cell) else (low, middle)
        return low

    def _at(self, place: Place) -> tuple[int, int]:
        index = np.round((np.asarray(place) - self._low) / self._cell).astype(int)
        x, y = np.clip(index, 0, np.array(self._clearance.shape) - 1)
        return int(x), int(y)


def _straight(planner: ReactivePlanner, world: World, way: _Way) -> float | None:
    """Return the time that a straight way takes [s]; None if it is not clear."""
    length = math.dist(way.here, way.there)
    points = np.linspace(way.here, way.there, max(2, math.ceil(length / _CELL)))
    clear = bool((world.signed_distance(points) >= planner.clearance - 1e-9).all())
    return length / planner.speed + _STRAIGHT_EXTRA if clear else None


def _driven(planner: ReactivePlanner, walls: Array, way: _Way, step: float) -> float | None:
    """Return the time until a robot that moves exactly as commanded arrives [s]; None if it does not.

    The robot starts towards its goal.
    """
    (x, y), there = way.here, way.there
    pose = np.array((x, y, math.atan2(there[1] - y, there[0] - x)))
    for count in range(math.ceil(_PATIENCE * way.longest / step)):
        if planner.there(pose, there):
            return count * step
        near = walls[np.abs(walls - pose[:2]).max(axis=1) < 2.0 * planner.look_ahead]
        speed, turn = planner.command(pose, near, there)
        middle = pose[2] + 0.5 * turn * step
        pose += (speed * step * math.cos(middle), speed * step * math.sin(middle), turn * step)
    return None
