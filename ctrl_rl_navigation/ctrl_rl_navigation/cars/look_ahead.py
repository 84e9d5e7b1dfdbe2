"""Chooses a car's command by its time to reach, from the ends of short roll-outs that touch nothing."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_navigation.cars.car_limits import CarLimits
from ctrl_rl_navigation.cars.car_value import CarValue
from ctrl_rl_navigation.cars.footprint import Footprint, distances, footprint_of
from ctrl_rl_navigation.cars.roll_out import (
    CURVATURE,
    CURVATURE_AFTER,
    END,
    HOLD,
    SPEED,
    SPEED_AFTER,
    STOPS,
    Arrival,
    Grid,
    Rules,
    choose,
)

Array = NDArray[np.float64]
Field = NDArray[np.float32]

STEP, HORIZON, LONGEST = 0.05, 1.5, 5.0
"""Step and duration of a roll-out [s], and that of the longest one with braking."""
_SPEEDS = (1.0, 0.5, 0.2)
"""Candidate speeds as fractions of the maximum, forward and in reverse."""
_CURVATURES, _AFTER = (-1.0, -0.5, -0.2, 0.0, 0.2, 0.5, 1.0), (-1.0, -0.4, 0.0, 0.4, 1.0)
"""Candidate curvatures as fractions of the maximum, at first and afterwards."""
_LAST = (-1.0, 0.0, 1.0)
"""Those of candidates that stop."""
_HOLDS = (0.12, 0.3, 0.6)
"""Fractions of the roll-out for which a candidate holds its speed and curvature."""
_STOPS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.95, 1.1, 1.3, 1.5)
"""Times after which a candidate brakes to a stop at the goal [s]."""
_FAVOUR, _SHORTEST = 0.15, 0.3
"""Amount by which another plan must be better than the rest of the last one [s], so that a car does not dither where it
changes its direction; and the rest that is too short to go on with [s]."""
_NOW = 1e-9
"""Time below which something happens now [s], as in a roll-out."""
_NEAR_GOAL = 3.0
"""Time to reach below which candidates that stop are tried [s]."""
_MARGINS = ((1.0, 1.0), (0.6, 1.0), (0.3, 0.5), (0.1, 0.2), (-0.1, 0.2))
"""Fractions of the margin that a roll-out keeps, tried in turn, and of the speed that it may have. The value keeps all
of the margin, up to its cells; the last ones lead a car away from what it almost touches, by the errors of a scan."""
_WITHIN = 1.4
"""Distance from the goal at which a candidate may stop, as a multiple of that at which the value is zero."""
_ECHO_CELL = 0.08
"""Maximum length of a cell of the obstacles of a scan [m]."""
_CELLS_PER_WIDTH = 12.0
"""Minimum number of such cells across the car."""


class CarLookAhead:
    """Chooses commands for one car.

    Args:
        limits: Size and limits of the car.
        period: Control period [s].
        delay: Time from a command to its effect [s].

    Attributes:
        steering: Steering angle by the commands that were sent [rad].
        speed: Speed by them [m/s].
        reach: Distance within which echoes matter [m].
    """

    def __init__(self, limits: CarLimits, period: float, delay: float) -> None:
        self._limits, self._period = limits, period
        self.steering = self.speed = 0.0
        speeds = (limits.speed, limits.reverse_speed)
        self._rules = Rules(
            speeds,
            limits.acceleration,
            limits.braking,
            limits.wheelbase,
            limits.steering_angle,
            limits.steering_rate,
            limits.change_time,
            delay,
            _share(STEP, limits.lag),
            _share(STEP, limits.steering_lag),
            STEP,
            round(LONGEST / STEP),
        )
        tightest = 1.0 / limits.turning_radius
        both = [sign * share * full for sign, full in zip((1.0, -1.0), speeds, strict=True) for share in _SPEEDS]
        goes_on = [
            (speed, first * tightest, hold * HORIZON, then, after * tightest, math.inf, HORIZON)
            for speed, first, hold, after in product(both, _CURVATURES, _HOLDS, _AFTER)
            for then in (speed, speeds[0] if speed < 0.0 else -speeds[1])
        ]
        stops = [
            (speed, first * tightest, 0.5 * hold, speed, after * tightest, hold, HORIZON)
            for speed, first, hold, after in product(both, _CURVATURES, _STOPS, _LAST)
        ]
        stand = [(0.0, first * tightest, HORIZON, 0.0, first * tightest, math.inf, HORIZON) for first in _CURVATURES]
        self._standing = np.array(stand)
        self._plan: Array | None = None
        self._going, self._stopping = np.array(goes_on), np.array(stops)
        self.reach = limits.radius + limits.speed * (HORIZON + limits.speed / limits.braking) + limits.margin
        self._cell = min(_ECHO_CELL, limits.width / _CELLS_PER_WIDTH)
        self._cells = 2 * math.ceil(self.reach / self._cell) + 1

    def forget(self, stands: bool = False) -> None:
        """Drop the last plan, for another goal; and know that the car stands with straight wheels, if it does."""
        self._plan = None
        if stands:
            self.steering = self.speed = 0.0

    def sent(self, command: Array) -> None:
        """Follow the steering by the command (2,) that was sent for the last period."""
        self.speed += _share(self._period, self._limits.lag) * (float(command[0]) - self.speed)
        if abs(command[0]) <= 1e-6:
            return
        limit = self._limits.steering_angle
        wanted = float(np.clip(math.atan(self._limits.wheelbase * command[1] / command[0]), -limit, limit))
        most, share = self._limits.steering_rate * STEP, self._rules.steering_share
        for _ in range(round(self._period / STEP)):
            self.steering += float(np.clip(share * (wanted - self.steering), -most, most))

    def choose(
        self, value: CarValue, field: Field, map_place: tuple[float, ...], pose: Array, command: Array, points: Array
    ) -> tuple[Array, float]:
        """Return the command to send (2,), and the predicted time to reach the goal [s], inf if none is free.

        Args:
            value: Time to reach the goal.
            field: Distances to the map's obstacles (rows, columns) [cells].
            map_place: Position of the centre of the field's first cell, its direction, and its cell [m, m, rad, m].
            pose: Pose x, y, theta in the map frame (3,) [m, m, rad].
            command: Last command sent (2,) [m/s, rad/s].
            points: Echoes in the robot's frame (n, 2) [m].
        """
        place = value.place
        grid = _seen_from(pose, place.x, place.y, place.yaw, place.cell)
        half = 0.5 * (self._cells - 1) * self._cell
        places = (_seen_from(pose, *map_place), Grid(-half, -half, 0.0, self._cell))
        fields, motion = (field, self._echo_field(points)), (float(command[0]), self.speed, self.steering)
        arrival = _arrival(value, pose)
        tried = self._going
        if float(value.value(pose)) < _NEAR_GOAL:
            tried = np.concatenate((tried, self._stopping))
        rest, favour = self._rest(), 0.0
        if rest is not None:
            tried, favour = np.concatenate((rest[None], tried)), _FAVOUR
        for candidates, kept in ((tried, favour), (self._standing, 0.0)):
            for share, pace in _MARGINS:
                shapes = (self._shape(share, map_place[3]), self._shape(share, self._cell))
                slow = np.abs(candidates[:, [SPEED, SPEED_AFTER]]).max(axis=1) <= pace * self._limits.speed
                best, cost = choose(
                    value.all_times,
                    grid,
                    arrival,
                    fields,
                    places,
                    shapes,
                    self._rules,
                    motion,
                    candidates[slow],
                    kept if slow[0] else 0.0,
                )
                if best >= 0:
                    self._plan = candidates[slow][best]
                    return self._command(self._plan, motion[0]), cost
        self._plan = None
        return self.slowed(motion[0], max(self._limits.braking, self._limits.hardest_braking)), math.inf

    def _rest(self) -> Array | None:
        """Return what is left of the last plan (7,) after a period; None if that is too little to go on with."""
        if self._plan is None:
            return None
        rest = self._plan.copy()
        rest[[HOLD, STOPS, END]] -= self._period
        ends = rest[END] if rest[STOPS] == math.inf else math.inf
        return rest if ends > _SHORTEST else None

    def _command(self, candidate: Array, v: float) -> Array:
        """Return speed and turn rate after a period of a candidate."""
        first, over = candidate[HOLD] > _NOW, candidate[STOPS] <= _NOW
        wanted = 0.0 if over else candidate[SPEED if first else SPEED_AFTER]
        slower = wanted * v < 0.0 or abs(wanted) < abs(v)
        most = (self._limits.braking if slower else self._limits.acceleration) * self._period
        speed = float(np.clip(wanted, v - most, v + most))
        return np.array((speed, speed * candidate[CURVATURE if first else CURVATURE_AFTER]))

    def slowed(self, v: float, braking: float = 0.0) -> Array:
        """Return the command (2,) that brakes from a speed [m/s], with the steering as it is.

        Args:
            v: Speed of the last command [m/s].
            braking: Deceleration [m/s^2]; 0 for the planned one.
        """
        most = (braking or self._limits.braking) * self._period
        speed = v - float(np.clip(v, -most, most))
        return np.array((speed, speed * math.tan(self.steering) / self._limits.wheelbase))

    def _shape(self, share: float, cell: float) -> Footprint:
        limits = self._limits
        return footprint_of(limits.length, limits.width, limits.centre, share * limits.margin, cell)

    def _echo_field(self, points: Array) -> Field:
        """Return the distances around the car to the echoes of a scan (rows, columns) [cells]."""
        from scipy.ndimage import distance_transform_edt  # slow import

        limits = self._limits
        half = np.array((0.5 * limits.length, 0.5 * limits.width)) - limits.margin
        points = points[(np.abs(points - (limits.centre, 0.0)) >= half).any(axis=1)]  # a lidar may see its own wheels
        cells = np.rint(points / self._cell).astype(np.int64) + (self._cells - 1) // 2
        cells = cells[((cells >= 0) & (cells < self._cells)).all(axis=1)]
        empty = np.full((self._cells, self._cells), True)
        empty[cells[:, 1], cells[:, 0]] = False
        if len(cells) == 0:
            return distances(np.full(empty.shape, np.inf, np.float32), 1.0)
        return distance_transform_edt(empty).astype(np.float32)


def _seen_from(pose: Array, x: float, y: float, yaw: float, cell: float) -> Grid:
    """Return a grid of the map frame in the frame of a pose (3,)."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = x - float(pose[0]), y - float(pose[1])
    return Grid(c * dx + s * dy, c * dy - s * dx, yaw - float(pose[2]), cell)


def _arrival(value: CarValue, pose: Array) -> Arrival:
    """Return a value's goal in the frame of a pose (3,)."""
    there = _seen_from(pose, *value.goal, 0.0 if value.heading is None else value.heading, 1.0)
    tolerance = math.pi if value.heading is None else _WITHIN * value.heading_tolerance
    return Arrival(there.x, there.y, there.yaw, _WITHIN * value.radius, tolerance)


def _share(time: float, lag: float) -> float:
    """Return the share of the way to its command that a quantity with a lag [s] goes in a time [s]."""
    return -math.expm1(-time / lag) if lag > 0.0 else 1.0
