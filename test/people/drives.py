"""One drive of the navigator among people, and what became of it."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from ctrl_rl_navigation.driving import Goal, Navigator, NavigatorDriver, NavigatorOptions, NavigatorState
from ctrl_rl_navigation.robot import limits_of
from ctrl_rl_safety.filter import SensorFilter
from missing_echoes.drives import STEP, advance
from numpy.typing import NDArray

from ctrl_rl_core import ScanGeometry, Sensors, find_robot, make_odometry
from ctrl_rl_safety import FilterOptions, RobotModel, SafetyFilter, find_model
from people.encounters import Encounter, draw
from people.world import STANDS, Walker, look, map_of, measure

Array = NDArray[np.float64]

ROBOT = "turtlebot3_burger"
_TICK = 10
"""Steps from command to command."""
_LOST = 0.02
"""Share of beams without an echo that should have one."""
_POSE_ERROR, _HEADING_ERROR = 0.02, 0.01
"""Standard deviations of the error of the pose on the map, which stays the same in a drive [m], [rad]."""
_MARGIN = 0.03
"""Distance that the navigator keeps to obstacles [m], as its node does."""
_FASTEST = 1.0
"""Speed of people that the filter assumes [m/s]."""
_SET_PERIOD = 0.2
_SPARE = 60.0
"""Time of a drive beyond twice the shortest one [s]."""
_WARNING, _REACTION = 3.0, 0.5
"""Time before a hit from which the robot could have left [s], and the time that it needs to begin [s]."""


class Ride(NamedTuple):
    """What became of a drive.

    Attributes:
        end: goal, contact (the robot drove), hit (it stood), or time.
        room: Whether the robot could have left before it was hit.
        seconds: Duration [s].
        slowest: Longest decision [s].
    """

    end: str
    room: bool
    seconds: float
    slowest: float


def ride(kind: str, seed: int, filtered: bool, trace: list[Array] | None = None) -> Ride:
    """Drive once.

    Args:
        kind: Kind of encounter, one of `KINDS`.
        seed: Seed of world, noise and errors.
        filtered: Whether the safety filter is below the navigator.
        trace: List to which the robot's state and the places of people are added at each command.
    """
    model = find_model(ROBOT)
    encounter = draw(kind, seed, find_robot(ROBOT).plan.speed)
    return _Drive(encounter, model, np.random.default_rng((seed, 99)), filtered).run(trace)


class _Drive:
    def __init__(self, encounter: Encounter, model: RobotModel, random: np.random.Generator, filtered: bool) -> None:
        robot = find_robot(ROBOT)
        # The filter's model turns as quickly as any such robot does at least; this one does as its planner thinks.
        self._model = replace(model, turn_acceleration=robot.plan.turn_acceleration)
        self._encounter, self._random = encounter, random
        self._walkers = [Walker(person) for person in encounter.people]
        spec = robot.lidar.spec
        assert spec is not None, "the robot's file has its lidar"
        self._lidar_x, reach = robot.lidar.x, spec.range
        self._scan = ScanGeometry(spec.beams, spec.angle_min, spec.angle_increment, reach.low, reach.high)
        self._scan_steps = round(1.0 / (spec.rate * STEP))
        navigator = Navigator(limits_of(robot, _MARGIN), NavigatorOptions(inline=True))
        navigator.set_map(map_of(encounter))
        navigator.set_goal(Goal((float(encounter.goal[0]), float(encounter.goal[1]))))
        self._driver = NavigatorDriver(navigator, self._lidar_x)
        options = FilterOptions(period=_TICK * STEP, mover_speed=_FASTEST, evade=True)
        safety = SafetyFilter(model, options)
        self._filter = SensorFilter(safety, self._lidar_x, _SET_PERIOD) if filtered else None
        self._error = random.normal(0.0, (_POSE_ERROR, _POSE_ERROR, _HEADING_ERROR))
        self._places: list[Array] = []

    def run(self, trace: list[Array] | None) -> Ride:
        encounter, model = self._encounter, self._model
        state = np.array((*encounter.start, 0.0, 0.0))
        under_way = deque[tuple[int, Array]]()
        command, sent = np.zeros(2), np.zeros(2)
        ranges, seen_at, slowest = np.empty(0, np.float32), 0, 0.0
        longest = 2.0 * math.dist(encounter.start[:2], encounter.goal) / model.speed + _SPARE
        for step in range(round(longest / STEP)):
            now = step * STEP
            if step % self._scan_steps == 0:
                ranges, seen_at = self._measure(state), step
            if step % _TICK == 0:
                sensors = self._sensors(state, ranges, sent, now, now - seen_at * STEP)
                sent, took = self._decide(sensors)
                slowest = max(slowest, took)
                if self._driver.decision.state is NavigatorState.REACHED:
                    return Ride("goal", False, now, slowest)
                under_way.append((step + math.ceil(model.delay / STEP - 1e-9), sent))
                self._places.append(np.array([state[:2], *(walker.place for walker in self._walkers)]))
                if trace is not None:
                    trace.append(np.concatenate((state, sent, self._places[-1][1:].ravel())))
            while under_way and under_way[0][0] <= step:
                command = under_way.popleft()[1]
            advance(state, command, model)
            for walker in self._walkers:
                walker.advance(now, STEP, state[:2], float(state[3]), model.radius)
            gaps = [math.dist(each.place, state[:2]) - each.person.radius - model.radius for each in self._walkers]
            if min(gaps) < 0.0:
                if abs(state[3]) >= STANDS:
                    return Ride("contact", True, now, slowest)
                return Ride("hit", self._had_room(), now, slowest)
            if self._to_wall(state[:2]) < model.radius:
                return Ride("contact", True, now, slowest)
        return Ride("time", False, longest, slowest)

    def _measure(self, state: Array) -> NDArray[np.float32]:
        c, s = math.cos(state[2]), math.sin(state[2])
        origin = state[:2] + self._lidar_x * np.array((c, s))
        exact = look(origin, self._scan, float(state[2]), self._encounter, self._walkers)
        return measure(exact, self._random, _LOST)

    def _sensors(self, state: Array, ranges: NDArray[np.float32], sent: Array, now: float, age: float) -> Sensors:
        odometry = make_odometry(state[:3].copy(), np.array((state[3], 0.0, state[4])))
        return Sensors(ranges, self._scan, odometry, state[:3] + self._error, None, sent, now, age)

    def _decide(self, sensors: Sensors) -> tuple[Array, float]:
        begin = time.perf_counter()
        command = self._driver.command(sensors)
        took = time.perf_counter() - begin
        return (command if self._filter is None else self._filter(sensors, command)), took

    def _to_wall(self, places: Array) -> Array:
        """Return the distance of places (..., 2) to the walls (...) [m]."""
        return np.asarray(np.minimum(places, self._encounter.room - places).min(axis=-1))

    def _had_room(self) -> bool:
        """Return whether a robot that had turned and driven straight would not have been touched, in hindsight."""
        model, places = self._model, self._places
        back = round(_WARNING / (_TICK * STEP))
        begin = max(len(places) - back, 0)
        here, people = places[begin][0], np.array([each[1:] for each in places[begin:]])
        radii = np.array([walker.person.radius for walker in self._walkers])
        times = _TICK * STEP * np.arange(len(people))
        for bearing in np.arange(0.0, 2.0 * math.pi, math.pi / 8.0):
            # It may have to turn by half a turn before it drives.
            driven = np.maximum(times - _REACTION - math.pi / model.turn_rate, 0.0) * model.speed
            for far in (0.2, 0.3, 0.4, 0.6):
                way = here + np.minimum(driven, far)[:, None] * (math.cos(bearing), math.sin(bearing))
                if (self._to_wall(way) < model.radius + 0.05).any():
                    continue
                gaps = np.linalg.norm(people - way[:, None], axis=2) - radii - model.radius
                if (gaps > 0.0).all():
                    return True
        return False
