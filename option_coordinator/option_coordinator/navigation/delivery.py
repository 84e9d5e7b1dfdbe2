"""One robot's work in a delivery team: its options, their rewards, and the reactive planner."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from ctrl_rl_core.sensing import echoes
from ctrl_rl_core.tasks import wrap
from numpy.typing import NDArray

from ctrl_rl_core import ScanGeometry
from option_coordinator.protocol.option_executor import AgentObservation, OptionResult
from option_coordinator.teams.team_file import TeamFile, Work

Array = NDArray[np.float64]

STAND = (0.0, 0.0)


@dataclass(frozen=True)
class ReactivePlanner:
    """Computes speed and turn rate towards a goal.

    Attributes:
        speed: Maximum forward speed [m/s].
        turn: Maximum turn rate [rad/s].
        half_width: Half-width of the strip that must be free of obstacles [m].
        look_ahead: Length of the strip that must be free [m].
        stop: Distance from the robot's centre to an obstacle ahead at which the robot stops [m].
        arrived: Distance to the goal at which the robot has arrived [m].
    """

    speed: float = 0.2
    turn: float = 1.5
    half_width: float = 0.24
    look_ahead: float = 0.55
    stop: float = 0.27
    arrived: float = 0.08

    def there(self, pose: Array, place: tuple[float, float]) -> bool:
        """Return whether a pose x, y, theta (3,) is at the goal."""
        return math.hypot(place[0] - pose[0], place[1] - pose[1]) <= self.arrived

    def command(self, pose: Array, points: Array, place: tuple[float, float]) -> tuple[float, float]:
        """Return speed [m/s] and turn rate [rad/s].

        The planner takes the free direction nearest to the goal's; ties go to the right, so that two robots that meet
        pass each other.

        Args:
            pose: Pose x, y [m], theta [rad] (3,).
            points: Points seen by the lidar, in the frame of the pose (n, 2) [m].
            place: Goal position [m].
        """
        points = _seen_from(pose, points)
        dx, dy = place[0] - pose[0], place[1] - pose[1]
        distance, bearing = math.hypot(dx, dy), float(wrap(math.atan2(dy, dx) - pose[2]))
        if distance <= self.arrived:
            return STAND
        direction = self._free_direction(points, bearing, min(distance, self.look_ahead))
        if direction is None:
            return 0.0, -0.5 * self.turn
        turn = float(np.clip(2.5 * direction, -self.turn, self.turn))
        speed = min(self.speed, distance) * max(0.0, math.cos(direction)) ** 3
        if abs(direction) > 1.0 or self._nearest(points, 0.0) < self.stop:
            speed = 0.0
        return speed, turn

    def _free_direction(self, points: Array, bearing: float, reach: float) -> float | None:
        """Return the free direction nearest to a bearing; if there is none, accept one free for half the distance."""
        for far in (reach, 0.5 * reach):
            for offset in np.deg2rad(np.arange(0, 111, 10)):
                for direction in (bearing - offset, bearing + offset):
                    if self._nearest(points, direction) > far:
                        return float(wrap(direction))
        return None

    def _nearest(self, points: Array, direction: float) -> float:
        """Return the free distance along the strip in a direction [m]."""
        c, s = math.cos(direction), math.sin(direction)
        along, aside = c * points[:, 0] + s * points[:, 1], c * points[:, 1] - s * points[:, 0]
        inside = along[(np.abs(aside) < self.half_width) & (along > 0.0)]
        return float(inside.min()) if len(inside) else math.inf


def scan_points(pose: Array, ranges: NDArray[np.float32], scan: ScanGeometry, forward: float) -> Array:
    """Return a scan's echoes as points (n, 2) [m] in the frame of the pose, which does not rotate with the robot.

    Args:
        pose: Pose x, y [m], theta [rad] (3,) of the robot at the time of the scan.
        ranges: Ranges as in REP-117 (beams,) [m].
        scan: Bearings and limits of the beams.
        forward: Position of the lidar ahead of the robot's centre [m].
    """
    points = echoes(ranges, scan, math.inf, forward)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.asarray(pose[:2] + points @ np.array(((c, s), (-s, c))))


def _seen_from(pose: Array, points: Array) -> Array:
    """Transform points to the robot's frame, x ahead."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.asarray((points - pose[:2]) @ np.array(((c, -s), (s, c))))


class Delivery:
    """One robot's work; all times are from the same clock [s].

    Args:
        team: Team file of the robot's team.
        name: Name of the robot in the team.

    Attributes:
        carries: Whether the robot carries a parcel.
        delivered: Number of parcels delivered.
        option: Index of the running option; None for none.
    """

    def __init__(self, team: TeamFile, name: str) -> None:
        self._team, self._home = team, team.robots[name].home
        self._options = tuple(team.options.values())
        self.carries, self.delivered = False, 0
        self.option: int | None = None
        self._began = 0.0
        self._arrived: float | None = None

    def see(self, pose: NDArray[np.float64]) -> AgentObservation:
        """Return the observation at a pose x, y, theta (3,), see `OBSERVED`, and the sensible options."""
        wanted = {Work.WAIT}
        if self.delivered == self._team.deliveries:
            wanted.add(Work.REST)
        else:
            wanted.add(Work.DELIVER if self.carries else Work.FETCH)
        observation = np.array((pose[0], pose[1], self.carries, self.delivered), np.float32)
        return AgentObservation(observation, np.array([option.work in wanted for option in self._options]))

    def begin(self, option: int, now: float) -> None:
        """Start an option."""
        self.option, self._began, self._arrived = option, now, None

    @property
    def place(self) -> tuple[float, float] | None:
        """Goal position of the option [m], or None."""
        if self.option is None:
            return None
        option = self._options[self.option]
        return self._home if option.work is Work.REST else option.station

    def at_place(self, now: float) -> OptionResult | None:
        """Record that the robot has reached the option's position; return the result once the option is done."""
        if self.option is None:
            return None
        self._arrived = now if self._arrived is None else self._arrived
        option = self._options[self.option]
        if now - self._arrived < option.lasts:
            return None
        reward = 0.0
        if option.work is Work.DELIVER and self.carries:
            self.carries, reward = False, self._team.rewards.delivery
            self.delivered += 1
        elif option.work is Work.FETCH:
            self.carries = True
        return self.leave(now, reward)

    def leave(self, now: float, reward: float = 0.0) -> OptionResult:
        """End the option and return its result; the reward belongs to the last step."""
        steps = max(1, round((now - self._began) / self._team.time_step))
        gamma = self._team.discount
        on_the_way = self._team.rewards.step * float(np.sum(gamma ** np.arange(steps)))
        self.option = None
        return OptionResult(on_the_way + gamma ** (steps - 1) * reward, steps)

    def over(self, option: int) -> bool:
        """Return whether the work is finished after an option."""
        return self._options[option].work is Work.REST
