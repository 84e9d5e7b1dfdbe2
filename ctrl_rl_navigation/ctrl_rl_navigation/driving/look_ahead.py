"""Chooses a command by the value at the end of short roll-outs, which avoid the echoes of the last scan.

A candidate is a command that is held for a while, after which the robot drives straight on. Its cost is the time of its
roll-out, the time to reach from where it ends, and the time to turn there into the direction of the value's descent.
Commands change within the limits of acceleration. This is the optimal control of the value, over a finite set.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_navigation.driving.roll_out import Place, Rules, choose
from ctrl_rl_navigation.robot import DriveLimits
from ctrl_rl_navigation.values.map_solver import EASE, SLOWEST, longest_time_beside
from ctrl_rl_navigation.values.map_value import MapValue

Array = NDArray[np.float64]

STEP = 0.1
"""Time step of a roll-out [s]."""
HORIZON = 1.6
"""Duration of a roll-out [s]."""
_HOLDS = (0.125, 0.3125, 0.625, 1.0)
"""Shares of the roll-out for which a candidate holds its command."""
SPEEDS = (0.0, 0.35, 0.7, 1.0)
"""Shares of the largest speed that are tried."""
REVERSING = (-0.3, *SPEEDS)
"""Those of a robot that cannot turn on the spot everywhere, and backs out."""
_TURNS = (-1.0, -0.7, -0.45, -0.25, -0.1, 0.0, 0.1, 0.25, 0.45, 0.7, 1.0)
"""Shares of the largest turn rate that are tried."""
TURNS_AFTER = (-0.5, -0.2, 0.0, 0.2, 0.5)
"""Those after a candidate's command with which a robot winds its way between obstacles."""


@dataclass(frozen=True)
class Choice:
    """The look-ahead's answer.

    Attributes:
        command: Speed [m/s] and turn rate [rad/s] to send now (2,).
        cost: Time to reach the goal that it expects [s]; inf where no command is safe.
        plan: Speed [m/s] and turn rate [rad/s] that it holds, for how long [s], and the turn rate after that (4,).
    """

    command: Array
    cost: float
    plan: Array


class LookAhead:
    """Chooses commands for one robot.

    Args:
        limits: Size and limits of the robot.
        period: Time from command to command [s].
        delay: Time from a command to its effect, and until the next one [s].
        deceleration: Deceleration of the robot when it brakes [m/s^2].
        step: Time step of a roll-out [s].
        horizon: Duration of a roll-out [s].
        ease: Additional clearance from which on driving costs no more than its time [m].
        slowest: Share of the full speed that driving beside an obstacle is counted with.
        turns_after: Shares of the largest turn rate that are tried after a candidate's command; 0 is straight on.
        speeds: Shares of the largest speed that are tried; negative ones are backwards.
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
        held = [
            (speed * limits.speed, turn * limits.turn_rate, hold * horizon, after * limits.turn_rate)
            for speed in speeds
            for turn in _TURNS
            for hold in _HOLDS
            for after in (turns_after if hold < 1.0 else (0.0,))
            if turn != after or hold == 1.0
        ]
        self._candidates = np.array(held)
        self.reach = limits.speed * horizon + limits.gap + ease + math.hypot(0.5 * limits.length, 0.5 * limits.width)

    def choose(
        self,
        value: MapValue,
        pose: Array,
        command: Array,
        points: Array,
        plan: Array | None = None,
        stuck: bool = False,
    ) -> Choice:
        """Return the command to send.

        Where the last choice's plan is given, the rest of it is a candidate too. A robot that waits for a moment as the
        best plan begins so then goes on with it, and does not begin to wait again and again. It may still do so where a
        plan that drives at once would end before an obstacle, and one that waits first does not get so far: such a
        robot is stuck.

        Args:
            value: Time to reach the goal.
            pose: Pose x, y, theta in the map's frame (3,) [m, m, rad].
            command: Command that was sent last (2,) [m/s, rad/s].
            points: Echoes in the robot's frame (n, 2) [m], or with their velocities (n, 4) [m, m, m/s, m/s].
            plan: Plan of the last choice (4,), one period ago; None for none.
            stuck: Whether the robot is, so that plans that drive at once go before those that begin with standing or a
                turn on the spot.
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
        )
        near = points[np.hypot(points[:, 0], points[:, 1]) < self.reach]
        if near.shape[1] == 2:
            near = np.hstack((near, np.zeros_like(near)))
        motion = (float(command[0]), float(command[1]))
        candidates = self._candidates if plan is None else np.vstack((self._candidates, self._rest(plan)))
        in_turn = (candidates[candidates[:, 0] != 0.0], candidates) if stuck else (candidates,)
        echoes = np.ascontiguousarray(near.T)
        most = np.array((self.limits.acceleration, self.limits.turn_acceleration)) * self._period
        for tried in in_turn:
            best, cost = choose(value.times, place, echoes, self._rules, motion, tried)
            if best >= 0:
                return Choice(np.clip(tried[best, :2], command - most, command + most), cost, tried[best])
        turn = float(np.clip(0.0, motion[1] - most[1], motion[1] + most[1]))
        return Choice(np.array((0.0, turn)), math.inf, np.zeros(4))

    def _rest(self, plan: Array) -> Array:
        """Return what is left of a plan (4,) after one period."""
        held = plan[2] - self._period
        horizon = self._rules.step * self._rules.steps
        return np.array((*plan[:2], held, plan[3]) if held > 1e-9 else (self.limits.speed, plan[3], horizon, 0.0))
