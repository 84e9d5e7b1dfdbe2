"""A robot behind the safety filter rushes at poles of 2 to 10 cm, while its lidar loses beams and whole scans."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from ctrl_rl_safety.filter import beams_at
from numpy.typing import NDArray

from ctrl_rl_safety import FilterOptions, Reading, RobotModel, SafetyFilter, find_model

Array = NDArray[np.float64]

STEP = 0.01
"""Step of the simulation [s]."""
_SCAN, _TICK, _EPISODE = 10, 5, 1000
"""Steps from scan to scan, from command to command, and in an episode."""
_BEARINGS = np.radians(np.arange(0.0, 360.0, 0.5))
_REACH, _NOISE = 8.0, 0.01
_EXTRA = 0.6
"""Distance of the first pole beyond that in which the robot stops [m]; it must be seen first."""
_GAP = (0.1, 0.5)
"""Room between poles beyond the width of the robot's disc [m]."""


class Ride(NamedTuple):
    """The result of an episode.

    Attributes:
        contact: Whether the robot touched a pole.
        distance: Path length [m].
        clearance: Minimum clearance [m].
    """

    contact: bool
    distance: float
    clearance: float


def ride(robot: str, seed: int, lost: float, rate: float) -> Ride:
    """Drive one episode at full speed, with turns of random size and duration.

    Args:
        robot: Name of a robot with wheels; its lidar has 720 beams all around here, ten times a second.
        seed: Seed of poles, turns, noise and lost beams.
        lost: Probability that a beam is lost, and that a whole scan is.
        rate: Rate of missing that the filter assumes; 0 to trust each scan alone.
    """
    model = replace(find_model(robot), missing_rate=rate)
    # Places and turns are the same whatever is lost, so that episodes can be compared.
    random, luck = np.random.default_rng((seed, 11)), np.random.default_rng((seed, 12))
    poles, safety = draw_poles(random, model), SafetyFilter(model, FilterOptions(period=_TICK * STEP))
    state, under_way = np.zeros(5), deque[tuple[int, Array]]()
    command, raw, until, distance, least = np.zeros(2), np.zeros(2), 0, 0.0, math.inf
    for step in range(_EPISODE):
        now = step * STEP
        if step % _SCAN == 0:
            ranges = np.where(luck.random(len(_BEARINGS)) < lost, np.inf, look(state, poles, luck))
            if luck.random() < lost and step:
                ranges[:] = np.inf
            echo = np.isfinite(ranges)
            beams = beams_at(_BEARINGS, ranges)
            safety.see(now, state[:3].copy(), beams.ends[echo], beams=beams)
        if step % _TICK == 0:
            if step >= until:
                turn = random.uniform(-0.5, 0.5) * model.turn_rate * (step > 0)
                raw, until = np.array((model.speed, turn)), step + int(random.uniform(30.0, 200.0))
            reading = Reading(state[:3].copy(), float(state[3]), float(state[4]))
            sent = safety.decide(now, reading, raw).command
            safety.sent(now, sent)
            under_way.append((step + math.ceil(model.delay / STEP - 1e-9), sent))
        while under_way and under_way[0][0] <= step:
            command = under_way.popleft()[1]
        advance(state, command, model)
        distance += abs(state[3]) * STEP
        least = min(least, clearance(state, poles, model))
        if least < 0.0:
            return Ride(True, distance, least)
    return Ride(False, distance, least)


def draw_poles(random: np.random.Generator, model: RobotModel) -> Array:
    """Return poles x, y, radius (n, 3) [m]: one straight ahead and others around."""
    stop = model.stopping_distance(model.speed) + model.speed * (model.delay + 0.2)
    first = model.radius + stop + _EXTRA
    poles = [(first, random.uniform(-0.7, 0.7) * model.half_width, random.uniform(0.01, 0.05))]
    while len(poles) < 25:
        (x, y), r = random.uniform(-2.0, 2.0, 2) * (2.0 * first), random.uniform(0.01, 0.05)
        apart = 2.0 * model.radius + random.uniform(*_GAP)
        if math.hypot(x, y) > first and all(math.hypot(x - a, y - b) - r - c > apart for a, b, c in poles):
            poles.append((x, y, r))
        elif random.random() < 0.005:  # the place is full
            break
    return np.array(poles)


def look(state: Array, poles: Array, random: np.random.Generator) -> Array:
    """Return the ranges of a scan (n,), infinite without an echo [m]."""
    c, s = np.cos(_BEARINGS + state[2]), np.sin(_BEARINGS + state[2])
    dx, dy = poles[:, :1] - state[0], poles[:, 1:2] - state[1]
    along = dx * c + dy * s
    inside = poles[:, 2:] ** 2 - (dx**2 + dy**2 - along**2)
    ranges = np.where((inside > 0.0) & (along > 0.0), along - np.sqrt(np.maximum(inside, 0.0)), np.inf).min(axis=0)
    ranges[ranges > _REACH] = np.inf
    return np.asarray(ranges + _NOISE * np.clip(random.standard_normal(len(ranges)), -2.5, 2.5))


def advance(state: Array, command: Array, model: RobotModel) -> None:
    """Move the robot's state (5,) by a step, within the limits of its model."""
    away = command[0] * state[3] >= 0.0 and abs(command[0]) > abs(state[3])
    most = (model.acceleration if away else model.braking) * STEP
    lag = max(model.lag, STEP)
    state[3] += min(max((command[0] - state[3]) * STEP / lag, -most), most)
    turn = model.turn_acceleration * STEP
    state[4] += min(max((command[1] - state[4]) * STEP / lag, -turn), turn)
    middle = state[2] + 0.5 * state[4] * STEP
    state[:3] += STEP * np.array((state[3] * math.cos(middle), state[3] * math.sin(middle), state[4]))


def clearance(state: Array, poles: Array, model: RobotModel) -> float:
    """Return the distance from the robot to the nearest pole [m]."""
    c, s = math.cos(state[2]), math.sin(state[2])
    beside = np.abs((poles[:, :2] - state[:2]) @ np.array(((c, -s), (s, c)))) - model.core
    gaps = np.hypot(*np.maximum(beside, 0.0).T) - poles[:, 2] - (0.0 if model.length else model.radius)
    return float(gaps.min())
