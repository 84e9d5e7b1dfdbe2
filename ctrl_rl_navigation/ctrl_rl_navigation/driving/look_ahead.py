"""Chooses a command by the value at the end of short roll-outs that avoid the echoes of the last scan and movers.

A candidate is a command held for some time, followed by driving straight ahead. Its cost is the duration of the
roll-out, plus the time to reach from its end, plus the time to turn there into the value's descent direction. Where
there are movers, their risk along the roll-out is added, and the delay that they cause from its end on. Commands
change within the acceleration limits. This is the optimal control for the value over a finite set.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_navigation.driving.roll_out import Place, Rules, choose
from ctrl_rl_navigation.people.movers import NOBODY, advanced, placed
from ctrl_rl_navigation.people.space_time import NO_WINDOW, SpaceTime
from ctrl_rl_navigation.robot import DriveLimits
from ctrl_rl_navigation.values.map_solver import EASE, SLOWEST, longest_time_beside
from ctrl_rl_navigation.values.map_value import MapValue

Array = NDArray[np.float64]

LAG = 0.05
"""Time that a robot takes to follow a command, beyond its delay [s]."""
STEP = 0.1
"""Time step of a roll-out [s]."""
HORIZON = 1.6
"""Duration of a roll-out [s]."""
_HOLDS = (0.125, 0.3125, 0.625, 1.0)
"""Fractions of the roll-out for which a candidate holds its command."""
SPEEDS = (0.0, 0.35, 0.7, 1.0)
"""Candidate speeds as fractions of the maximum."""
REVERSING = (-0.3, *SPEEDS)
"""Candidate speeds of a robot that cannot turn in place everywhere, and backs out."""
_TURNS = (-1.0, -0.7, -0.45, -0.25, -0.1, 0.0, 0.1, 0.25, 0.45, 0.7, 1.0)
"""Candidate turn rates as fractions of the maximum."""
TURNS_AFTER = (-0.5, -0.2, 0.0, 0.2, 0.5)
"""Turn rates after a candidate's command, for winding between obstacles."""


@dataclass(frozen=True)
class Choice:
    """Result of the look-ahead.

    Attributes:
        command: Speed [m/s] and turn rate [rad/s] to send now (2,).
        cost: Predicted time to reach the goal [s]; inf if no command is safe.
        plan: Speed [m/s], turn rate [rad/s], hold time [s], and subsequent turn rate [rad/s] (4,).
    """

    command: Array
    cost: float
    plan: Array


class LookAhead:
    """Chooses commands for one robot.

    Args:
        limits: Size and limits of the robot.
        period: Control period [s].
        delay: Time from a command to its effect, plus the time until the next one [s].
        deceleration: Braking deceleration of the robot [m/s^2].
        step: Time step of a roll-out [s].
        horizon: Duration of a roll-out [s].
        ease: Additional clearance above which driving has no extra cost [m].
        slowest: Fraction of the full speed assumed for the cost of driving next to an obstacle.
        turns_after: Turn rates after a candidate's command, as fractions of the maximum; 0 is straight ahead.
        speeds: Candidate speeds as fractions of the maximum; negative ones are reverse.
    """

    def __init__(
        self,
        limits: DriveLimits,
        period: float,
        delay: float,
        deceleration: float,
        step: float = STEP,
        horizon: float = HORIZON,
        ease: float = EASE,
        slowest: float = SLOWEST,
        turns_after: tuple[float, ...] = (0.0,),
        speeds: tuple[float, ...] = SPEEDS,
    ) -> None:
        self.limits, self._period = limits, period
        self._rules = Rules(
            limits.speed,
            limits.reverse_speed,
            limits.turn_rate,
            limits.acceleration,
            limits.turn_acceleration,
            limits.room,
            limits.gap,
            0.5 * limits.length,
            0.5 * limits.width,
            delay,
            deceleration,
            ease,
            slowest,
            step,
            round(horizon / step),
        )
        self._candidates = self._plans(speeds, turns_after)
        # Among people it may also make room backwards.
        back = (-min(limits.reverse_speed / limits.speed, 1.0),) if limits.reverse_speed else ()
        self._evasive = self._plans((*back, *speeds), turns_after)
        self._last: Array | None = None
        self._space_time = SpaceTime(limits, horizon)
        self.reach = limits.speed * horizon + limits.gap + ease + math.hypot(0.5 * limits.length, 0.5 * limits.width)

    def _plans(self, speeds: tuple[float, ...], turns_after: tuple[float, ...]) -> Array:
        """Return candidates (n, 4) from speeds and turn rates as fractions of the maximum."""
        limits, horizon = self.limits, self._rules.step * self._rules.steps
        held = [
            (speed * limits.speed, turn * limits.turn_rate, hold * horizon, after * limits.turn_rate)
            for speed in speeds
            for turn in _TURNS
            for hold in _HOLDS
            for after in (turns_after if hold < 1.0 else (0.0,))
            if turn != after or hold == 1.0
        ]
        return np.array(held)

    def choose(
        self,
        value: MapValue,
        pose: Array,
        command: Array,
        points: Array,
        plan: Array | None = None,
        stuck: bool = False,
        movers: Array = NOBODY,
    ) -> Choice:
        """Return the command to send.

        If the plan of the last choice is given, its remainder is a candidate too; among movers it always is. A robot
        whose best plan starts with a short wait then continues that plan instead of waiting repeatedly. It may still
        wait repeatedly if a plan that drives immediately would end at an obstacle, and one that waits first does not
        get that far: such a robot is stuck.

        Args:
            value: Time to reach the goal.
            pose: Pose x, y, theta in the map frame (3,) [m, m, rad].
            command: Last command sent (2,) [m/s, rad/s].
            points: Echoes of what stands in the robot's frame (n, 2) [m].
            plan: Plan of the last choice (4,), one period ago, or None.
            stuck: Whether the robot is stuck; plans that drive immediately are then preferred to those that start by
                standing or turning in place.
            movers: Predicted movers in the map frame (m, 12), see `people.movers`.
        """
        origin = value.map.origin
        dx, dy = value.goal[0] - pose[0], value.goal[1] - pose[1]
        c, s = math.cos(pose[2]), math.sin(pose[2])
        place = Place(
            origin[0],
            origin[1],
            math.cos(origin[2]),
            math.sin(origin[2]),
            value.map.resolution,
            float(pose[0]),
            float(pose[1]),
            float(pose[2]),
            float(c * dx + s * dy),
            float(c * dy - s * dx),
            value.radius,
            longest_time_beside(value.radius, self.limits),
            value.along,
        )
        near = points[np.hypot(points[:, 0], points[:, 1]) < self.reach]
        window, around = NO_WINDOW, NOBODY
        if len(movers):
            # A command takes effect later, when robot and movers have gone on.
            late = self._rules.delay - self._period + LAG
            movers = advanced(movers, late)
            plan = self._last if plan is None else plan
            standing = points @ np.array(((c, s), (-s, c))) + pose[:2]
            window = self._space_time.window(value, pose, movers, standing)
            theta = float(pose[2]) + 0.5 * late * float(command[1])
            x, y = pose[:2] + late * float(command[0]) * np.array((math.cos(theta), math.sin(theta)))
            around = placed(movers, float(x), float(y), float(pose[2]) + late * float(command[1]))
        motion = (float(command[0]), float(command[1]))
        candidates = self._evasive if len(movers) else self._candidates
        if plan is not None:
            candidates = np.vstack((candidates, self._rest(plan)))
        in_turn = (candidates[candidates[:, 0] != 0.0], candidates) if stuck else (candidates,)
        echoes = np.ascontiguousarray(near.T)
        most = np.array((self.limits.acceleration, self.limits.turn_acceleration)) * self._period
        for tried in in_turn:
            best, cost = choose(value.times, window, place, echoes, around, self._rules, motion, tried)
            if best >= 0:
                self._last = tried[best]
                return Choice(np.clip(tried[best, :2], command - most, command + most), cost, tried[best])
        turn = float(np.clip(0.0, motion[1] - most[1], motion[1] + most[1]))
        return Choice(np.array((0.0, turn)), math.inf, np.zeros(4))

    def _rest(self, plan: Array) -> Array:
        """Return the remainder of a plan (4,) after one period."""
        held = plan[2] - self._period
        horizon = self._rules.step * self._rules.steps
        return np.array((*plan[:2], held, plan[3]) if held > 1e-9 else (self.limits.speed, plan[3], horizon, 0.0))
