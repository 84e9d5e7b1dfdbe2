"""Slows and stops a robot in front of obstacles: geometry on the echoes of a scan, without ROS.

A command (v, omega) sweeps the robot's disc along an arc. On the arc lie the way that the robot goes before anything
can change, and the way that it brakes. Where an echo lies within the disc and its margin there, and nearer than it is
now, the command is slowed, and where that does not help, only the turning is left of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_PACES = (1.0, 0.7, 0.4)
"""Parts of a command's speed that are tried; a slower robot needs less room."""
_STEP = 0.04
"""Distance between two checked places on the arc [m], at most."""
_TURN_STEP = 0.1
"""Turn between two checked places [rad], at most: on a narrow arc the robot comes nearer between them, too."""
_FARTHEST = 4.0
"""Upper bound of the stopping distance [m], whatever odometry says."""
_NEARER = 1e-3
"""Distance by which an echo must come nearer to count [m]: a robot beside a wall may go along it."""
_STANDS = 1e-3
"""Speed below which nothing is swept [m/s]: a disc that turns on the spot stays where it is."""


@dataclass(frozen=True)
class ObstacleStop:
    """Size and braking of a robot, which give the room that it needs.

    Attributes:
        radius: Radius of the disc around the robot's middle that holds all of it [m]; 0 for no obstacle stop.
        margin: Additional distance to obstacles [m].
        deceleration: Deceleration of its brakes [m/s^2].
        delay: Time from a command to its effect, plus the time until the next command [s].
    """

    radius: float
    margin: float
    deceleration: float
    delay: float

    def reach(self, speed: float, age: float) -> float:
        """Return the stopping distance [m] at a speed [m/s], for a scan of some age [s]."""
        room = speed * (self.delay + age) + 0.5 * speed * speed / self.deceleration
        return room if room < _FARTHEST else _FARTHEST  # of NaN, too

    def limit(self, command: Array, points: Array, v: float, age: float) -> tuple[Array, str]:
        """Return the safe part of a command (2,), and the reason where it is less than the whole.

        Args:
            command: Speed [m/s] and turn rate [rad/s] (2,).
            points: Echoes in the robot's frame (n, 2) [m].
            v: Speed by odometry [m/s].
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

    def _hit(self, points: Array, room: float, curvature: float) -> float:
        """Return the way [m] on an arc of some length [m] until the disc meets an echo; inf where it meets none."""
        wide = self.radius + self.margin
        x, y = points[:, 0], points[:, 1]
        now = x * x + y * y
        close = np.flatnonzero(now < (abs(room) + wide) ** 2)
        if len(close) == 0:
            return math.inf
        x, y, now = x[close], y[close], np.sqrt(now[close])
        bend = abs(curvature)
        way = min(abs(room), math.tau / bend) if bend > 0.0 else abs(room)  # after a whole turn it repeats itself
        count = math.ceil(way * max(1.0 / _STEP, bend / _TURN_STEP))
        s = np.linspace(0.0, math.copysign(way, room), count + 1)[1:]
        turn = 0.5 * s * curvature
        chord = s * np.sinc(turn / math.pi)
        there = np.hypot(x[:, None] - chord * np.cos(turn), y[:, None] - chord * np.sin(turn))
        hit = ((there < wide) & (there < now[:, None] - _NEARER)).any(axis=0)
        return abs(float(s[hit.argmax()])) if hit.any() else math.inf
