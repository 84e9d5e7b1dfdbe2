"""One episode: a filtered robot rushes at poles, and moves otherwise than its model says."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from ctrl_rl_safety.filter import beams_at
from ctrl_rl_safety.monitor import RobotMonitor
from missing_echoes.drives import advance, clearance, draw_poles, look
from numpy.typing import NDArray

from ctrl_rl_safety import FilterOptions, Reading, RobotModel, SafetyFilter, find_model

Array = NDArray[np.float64]

STEP = 0.01
"""Step of the simulation [s]."""
_SCAN, _TICK, _ODOMETRY, _EPISODE = 10, 5, 2, 1000
"""Steps from scan to scan, from command to command, between odometry messages, and in an episode."""
_BEARINGS = np.radians(np.arange(0.0, 360.0, 0.5))
_SPEED_NOISE, _TURN_NOISE, _PLACE_NOISE, _SCALE = 0.01, 0.02, 0.002, 0.01
"""Errors of the odometry: of speed [m/s], turn rate [rad/s] and position [m], and relative ones of both speeds."""


@dataclass(frozen=True)
class Fault:
    """How a robot differs from its model.

    Attributes:
        name: Name in results.
        braking: Braking relative to the stated one.
        delay: Additional delay [s].
        acceleration: Acceleration relative to the stated one.
        yaw: Angle by which the lidar is turned [rad].
        begins: Time from which on the motion differs [s].
    """

    name: str
    braking: float = 1.0
    delay: float = 0.0
    acceleration: float = 1.0
    yaw: float = 0.0
    begins: float = 0.0

    def of(self, model: RobotModel, time: float = math.inf) -> RobotModel:
        """Return the robot that a model is to describe, at a time [s]."""
        if time < self.begins:
            return model
        return replace(
            model,
            braking=self.braking * model.braking,
            delay=model.delay + self.delay,
            acceleration=self.acceleration * model.acceleration,
        )


class Ride(NamedTuple):
    """The result of an episode.

    Attributes:
        contact: Whether the robot touched a pole.
        distance: Path length [m].
        clearance: Minimum clearance [m].
        grown: Time from the fault's begin until the monitor grew bounds or stopped the robot [s]; NaN if never.
        stands: Whether the monitor stopped the robot for good.
        words: What the monitor said last.
    """

    contact: bool
    distance: float
    clearance: float
    grown: float
    stands: bool
    words: str


def ride(robot: str | RobotModel, seed: int, fault: Fault, fastest: float, monitored: bool) -> Ride:
    """Drive one episode at full speed, with turns of random size and duration.

    Args:
        robot: Name of a robot with wheels, or its model; its lidar has 720 beams all around here, ten times a second.
        seed: Seed of poles, turns and noise.
        fault: How the robot differs from its model.
        fastest: Maximum speed commanded [m/s].
        monitored: Whether the filter has a monitor.
    """
    model = find_model(robot) if isinstance(robot, str) else robot
    speed = min(fastest, model.speed)
    random, luck = np.random.default_rng((seed, 21)), np.random.default_rng((seed, 22))
    poles, safety = (
        draw_poles(random, replace(model, speed=speed)),
        SafetyFilter(model, FilterOptions(period=_TICK * STEP)),
    )
    monitor = RobotMonitor(model, 0.0) if monitored else None
    scales = 1.0 + luck.uniform(-_SCALE, _SCALE, 2)
    state, under_way, command = np.zeros(5), deque[tuple[int, Array]](), np.zeros(2)
    raw, until, distance, least, grown = np.zeros(2), 0, 0.0, math.inf, math.nan
    for step in range(_EPISODE):
        now = step * STEP
        truth = fault.of(model, now)
        measured = _measured(state, scales, luck)
        if monitor is not None and step % _ODOMETRY == 0:
            monitor.motion.measure(now, measured[:3], float(measured[3]), float(measured[4]))
            safety.adopt(monitor.model, monitor.soonest)
            if math.isnan(grown) and (monitor.words() or monitor.problem):
                grown = now - fault.begins
        if step % _SCAN == 0:
            ranges = look(state + np.array((0.0, 0.0, fault.yaw, 0.0, 0.0)), poles, luck)
            beams = beams_at(_BEARINGS, ranges)
            echoes = beams.ends[np.isfinite(ranges)]
            safety.see(now, measured[:3].copy(), echoes, beams=beams)
            if monitor is not None:
                monitor.mounting.look(measured[:3], echoes)
        if step % _TICK == 0:
            if step >= until:
                turn = random.uniform(-0.5, 0.5) * model.turn_rate * (step > 0)
                raw, until = np.array((speed, turn)), step + int(random.uniform(30.0, 200.0))
            sent = safety.decide(now, Reading(measured[:3].copy(), float(measured[3]), float(measured[4])), raw).command
            if monitor is not None:
                sent = safety.stopping(now) if monitor.problem else sent
                monitor.motion.sent(now, sent)
            safety.sent(now, sent)
            under_way.append((step + math.ceil(truth.delay / STEP - 1e-9), sent))
        while under_way and under_way[0][0] <= step:
            command = under_way.popleft()[1]
        advance(state, command, truth)
        distance += abs(state[3]) * STEP
        least = min(least, clearance(state, poles, model))
        if least < 0.0:
            break
    stands, words = (False, "") if monitor is None else (bool(monitor.problem), monitor.problem or monitor.words())
    return Ride(least < 0.0, distance, least, grown, stands, words)


def _measured(state: Array, scales: Sequence[float] | Array, random: np.random.Generator) -> Array:
    """Return the odometry's view of a state (5,)."""
    out = state + random.uniform(-1.0, 1.0, 5) * (_PLACE_NOISE, _PLACE_NOISE, 0.001, _SPEED_NOISE, _TURN_NOISE)
    out[3:] += (np.asarray(scales) - 1.0) * state[3:]
    return np.asarray(out)
