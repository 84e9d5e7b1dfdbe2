"""Limits a command by the last scan: by its health, its gaps, and the obstacles in it. No ROS.

A command (v, omega) sweeps the robot's disc, or a car's rectangle, along an arc: first the distance covered before
anything can change, then the braking distance. If an echo lies within the swept shape plus its margin, and closer than
it is now, the command is slowed down; if that does not help, only its rotation is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.sensing.scan import ScanError, ScanGeometry, ScanView, Sensors, view_scan
from ctrl_rl_core.sensing.scan_health import ScanHealth, lidar_identity

Array = NDArray[np.float64]

_PACES = (1.0, 0.7, 0.4)
"""Fractions of a command's speed to try; a slower robot needs less room."""
_STEP = 0.04
"""Maximum distance between two checked positions on the arc [m]."""
_TURN_STEP = 0.1
"""Maximum turn between two checked positions [rad]; on a tight arc the robot also gets closer in between."""
_FARTHEST = 4.0
"""Upper bound of the stopping distance [m], regardless of odometry."""
_NEARER = 1e-3
"""Distance by which an echo must get closer to count [m], so that a robot may drive along a wall."""
_STANDS = 1e-3
"""Speed below which nothing is swept [m/s]: a disc that rotates in place covers no new area."""


@dataclass(frozen=True)
class ObstacleStop:
    """Size and braking capability of a robot, which determine the room that it needs.

    Attributes:
        radius: Radius of the disc around the robot's centre that encloses the robot [m]; 0 disables the obstacle stop.
        margin: Additional distance to obstacles [m].
        deceleration: Braking deceleration [m/s^2].
        delay: Time from a command to its effect, plus the time until the next command [s].
        rectangle: Distance from the centre to the rectangle's front and to its back, and half its width [m], for a
            robot that turns only while it drives; None for the disc.
    """

    radius: float
    margin: float
    deceleration: float
    delay: float
    rectangle: tuple[float, float, float] | None = None

    def reach(self, speed: float, age: float) -> float:
        """Return the stopping distance [m] at a speed [m/s], for a scan of the given age [s]."""
        room = speed * (self.delay + age) + 0.5 * speed * speed / self.deceleration
        return room if room < _FARTHEST else _FARTHEST  # also limits NaN

    def limit(self, command: Array, points: Array, v: float, age: float) -> tuple[Array, str]:
        """Return the safe part of a command (2,) and the reason for any reduction.

        Args:
            command: Speed [m/s] and turn rate [rad/s] (2,).
            points: Echoes in the robot's frame (n, 2) [m].
            v: Odometry speed [m/s].
            age: Age of the scan [s].
        """
        wanted, omega = command.tolist()
        if self.radius <= 0.0 or abs(wanted) < _STANDS or len(points) == 0:
            return command, ""
        distance = math.inf
        for pace in _PACES:
            speed = pace * wanted
            going = v if v * speed > 0.0 else 0.0
            room = self.reach(max(abs(speed), abs(going)), age)
            distance = self._hit(points, math.copysign(room, speed), omega / speed)
            if distance == math.inf:
                return (command if pace == 1.0 else np.array((speed, omega))), ""
        where = "ahead" if wanted > 0.0 else "behind"
        return np.array((0.0, omega)), f"obstacle {distance:.2f} m {where}"

    def _gap(self, x: Array, y: Array) -> Array:
        """Return the distances from the robot's shape to points in its frame (...) [m]."""
        if self.rectangle is None:
            return np.asarray(np.hypot(x, y) - self.radius)
        front, back, half = self.rectangle
        beyond = np.maximum(np.maximum(x - front, -back - x), 0.0)
        return np.asarray(np.hypot(beyond, np.maximum(np.abs(y) - half, 0.0)))

    def _hit(self, points: Array, room: float, curvature: float) -> float:
        """Return the arc length [m] at which the robot meets an echo, up to a given one [m]; inf if there is none."""
        x, y = points[:, 0], points[:, 1]
        close = np.flatnonzero(x * x + y * y < (abs(room) + self.radius + self.margin) ** 2)
        if len(close) == 0:
            return math.inf
        x, y = x[close], y[close]
        now = self._gap(x, y)
        bend = abs(curvature)
        way = min(abs(room), math.tau / bend) if bend > 0.0 else abs(room)  # the motion repeats after a full turn
        count = math.ceil(way * max(1.0 / _STEP, bend / _TURN_STEP))
        s = np.linspace(0.0, math.copysign(way, room), count + 1)[1:]
        turn = 0.5 * s * curvature
        chord = s * np.sinc(turn / math.pi)
        ahead, aside = x[:, None] - chord * np.cos(turn), y[:, None] - chord * np.sin(turn)
        if self.rectangle is not None:
            cos, sin = np.cos(2.0 * turn), np.sin(2.0 * turn)
            ahead, aside = cos * ahead + sin * aside, cos * aside - sin * ahead
        there = self._gap(ahead, aside)
        hit = ((there < self.margin) & (there < now[:, None] - _NEARER)).any(axis=0)
        return abs(float(s[hit.argmax()])) if hit.any() else math.inf


class DriveSafety:
    """Checks each scan and limits commands to what is safe; usable as a `Filter`.

    Args:
        health: Checks of the scans.
        obstacles: Braking distance and size of the robot.
        forward: Position of the lidar ahead of the robot's centre [m].
        reach: Distance from the lidar beyond which echoes are ignored [m].

    Attributes:
        reach: Distance from the lidar beyond which echoes are ignored [m].
        view: Echoes of the last scan; None if the scan is unusable.
        fault: Reason why the last scan forbids motion; empty if motion is allowed.
    """

    def __init__(self, health: ScanHealth, obstacles: ObstacleStop, forward: float, reach: float) -> None:
        self.view: ScanView | None = None
        self.fault = "no scan yet"
        self._health, self._obstacles = health, obstacles
        self._forward, self.reach = forward, reach

    def set_checks(self, health: ScanHealth, obstacles: ObstacleStop, reach: float) -> None:
        """Replace the checks, starting with the next scan."""
        self._health, self._obstacles, self.reach = health, obstacles, reach

    def update(
        self,
        now: float,
        stamp: int,
        frame: str,
        ranges: NDArray[np.float32],
        scan: ScanGeometry,
        motion: tuple[float, float],
    ) -> None:
        """Process a scan.

        Args:
            now: Steady time [s].
            stamp: Time stamp of the scan [ns].
            frame: Frame of the scan.
            ranges: Ranges (scan.beams,) [m].
            scan: Bearings and limits of the beams in the robot's frame.
            motion: Odometry speed [m/s] and turn rate [rad/s].
        """
        try:
            self.view = view_scan(ranges, scan, self.reach, self._forward)
        except ScanError as error:
            self.view, self.fault = None, str(error)
            return
        identity = lidar_identity(frame, scan)
        self.fault = self._health.update(now, self.view, ranges.tobytes(), stamp, identity, motion)

    def __call__(self, sensors: Sensors, command: Array) -> Array:
        """Return the safe part of a command (2,); zeros if the scan allows no motion in its direction."""
        v, omega = sensors.speeds
        if sensors.age == 0.0:
            self.update(sensors.time, round(1e9 * sensors.time), "scan", sensors.ranges, sensors.scan, (v, omega))
        try:
            return self.limit(command, v, sensors.age)[0]
        except ScanError:
            return np.zeros(2)

    def limit(self, command: Array, v: float, age: float) -> tuple[Array, str]:
        """Return the safe part of a command (2,) and the reason for any reduction.

        Args:
            command: Speed [m/s] and turn rate [rad/s] (2,).
            v: Odometry speed [m/s].
            age: Age of the last scan [s].

        Raises:
            ScanError: The last scan does not cover the direction of the command, so the robot must stop.
        """
        if not command.any():
            return command, ""
        if self.fault or self.view is None:
            raise ScanError(self.fault)
        problem = self._health.blind(self.view, float(command[0]))
        if problem:
            raise ScanError(problem)
        return self._obstacles.limit(command, self.view.points, v, age)
