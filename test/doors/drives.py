"""A robot drives through a door by a driver who aims off its middle, with the safety filter and without."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from ctrl_rl_safety.filter import beams_at
from missing_echoes.drives import STEP, advance
from numpy.typing import NDArray

from ctrl_rl_safety import FilterOptions, Reading, RobotModel, SafetyFilter, find_model
from doors.rooms import BEARINGS, clearance, look, room_with_door

Array = NDArray[np.float64]
Driver = Callable[[Array], Array]

_SCAN, _TICK = 10, 5
"""Steps from scan to scan, and from command to command."""
SCAN_INTERVAL = _SCAN * STEP
OPTIONS = FilterOptions(period=_TICK * STEP)
_FASTEST = 1.0
"""Speed above which nobody drives through a door [m/s]."""
_BEFORE, _BEHIND = 1.2, 1.0
"""Free way before and behind the door, beyond the robot's radius [m]."""
_MOST_OFF = 0.06
_LONGEST = 60.0
"""Time after which a robot counts as stuck [s]."""

MODELS = {
    # E-manual: 281 x 306 mm, 0.26 m/s, 1.82 rad/s. Its rectangle is centred at the axle, 64 mm ahead of the middle.
    "turtlebot3_waffle": RobotModel(
        "turtlebot3_waffle", 0.256, 0.26, 0.26, 1.82, 2.5, 2.5, 3.2, 0.05, 0.1, 0.02, 0.03, length=0.41, width=0.306
    ),
    # Brakes slowly and answers late.
    "half_metre": RobotModel("half_metre", 0.25, 1.0, 0.5, 1.5, 0.8, 0.6, 2.0, 0.1, 0.2, 0.03, 0.03),
    **{name: find_model(name) for name in ("turtlebot3_burger", "turtlebot4", "jackal")},
}


class Passage(NamedTuple):
    """One drive.

    Attributes:
        passed: Whether the robot has arrived behind the door.
        contact: Whether it touched anything.
        seconds: Duration [s].
    """

    passed: bool
    contact: bool
    seconds: float


class Approach(NamedTuple):
    """A door and a driver.

    Attributes:
        width: Width of the door [m].
        thickness: Thickness of its wall [m].
        start: Pose at the start [m, m, rad].
        driver: Returns the raw command for a state.
        speed: Speed of the driver [m/s].
    """

    width: float
    thickness: float
    start: tuple[float, float, float]
    driver: Driver
    speed: float


def draw_approach(
    model: RobotModel, seed: int, width_at: Callable[[float], float], spare: tuple[float, float]
) -> Approach:
    """Draw a door and a driver who aims 0 to 6 cm off its middle.

    Every third driver sends a constant command, every third follows a line, and every third steers for a goal.

    Args:
        model: The robot.
        seed: Seed of all numbers.
        width_at: Least width of a door by the speed of the driver.
        spare: Least and most width beyond that [m].
    """
    random = np.random.default_rng((seed, 21))
    speed = min(model.speed, _FASTEST) * random.uniform(0.6, 1.0)
    thickness, off = random.uniform(0.05, 0.3), random.choice((-1.0, 1.0)) * random.uniform(0.0, _MOST_OFF)
    beside, turned = random.uniform(-0.15, 0.15), math.radians(random.uniform(-10.0, 10.0))
    before = model.radius + _BEFORE + model.stopping_distance(speed)
    kind = seed % 3
    start = (-before, off + beside, turned) if kind else (-before, off, 0.0)
    goal = (thickness + model.radius + 2.0 * _BEHIND, off)

    def constant(_: Array) -> Array:
        return np.array((speed, 0.0))

    def along_line(state: Array) -> Array:
        heading = min(max(-1.5 * (state[1] - off), -0.6), 0.6)
        return np.array((speed, _turn(heading - state[2], model)))

    def to_goal(state: Array) -> Array:
        return np.array((speed, _turn(math.atan2(goal[1] - state[1], goal[0] - state[0]) - state[2], model)))

    width = width_at(speed) + random.uniform(*spare)
    return Approach(width, thickness, start, (constant, along_line, to_goal)[kind], speed)


def _turn(error: float, model: RobotModel) -> float:
    turn = 2.0 * math.remainder(error, 2.0 * math.pi)
    return min(max(turn, -model.turn_rate), model.turn_rate)


def pass_door(model: RobotModel, approach: Approach, seed: int, safety: SafetyFilter | None, with_set: bool) -> Passage:
    """Drive until the robot has passed, touches something or is stuck.

    Args:
        model: The robot.
        approach: Door and driver.
        seed: Seed of the noise.
        safety: Filter that has seen nothing, or None for no filter.
        with_set: Whether the filter has a recoverable set of each scan.
    """
    luck, boxes = np.random.default_rng((seed, 22)), room_with_door(approach.width, approach.thickness)
    state, under_way = np.array((*approach.start, 0.0, 0.0)), deque[tuple[int, Array]]()
    command = np.zeros(2)
    for step in range(round(_LONGEST / STEP)):
        now = step * STEP
        if safety is not None and step % _SCAN == 0:
            ranges = look(state, boxes, luck)
            beams = beams_at(BEARINGS, ranges)
            safety.see(now, state[:3].copy(), beams.ends[np.isfinite(ranges)], beams=beams)
            if with_set:
                safety.use(safety.solve())
        if step % _TICK == 0:
            sent = approach.driver(state)
            if safety is not None:
                reading = Reading(state[:3].copy(), float(state[3]), float(state[4]))
                sent = safety.decide(now, reading, sent).command
                safety.sent(now, sent)
            under_way.append((step + math.ceil(model.delay / STEP - 1e-9), sent))
        while under_way and under_way[0][0] <= step:
            command = under_way.popleft()[1]
        advance(state, command, model)
        if clearance(state, boxes, model) < 0.0:
            return Passage(False, True, now)
        if state[0] > approach.thickness + model.radius + _BEHIND:
            return Passage(True, False, now)
    return Passage(False, False, _LONGEST)
