"""Distances and rays between rounded rectangles in a plane, compiled by Numba.

A shape is a row (8,): centre x, y [m], cosine and sine of its counter-clockwise angle, half extents [m], rounding
radius [m], and whether rays hit it (1) or not (0). A disc is a point with a radius.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ctrl_rl_core.values import cached_njit

X, Y, COS, SIN, HALF_X, HALF_Y, RADIUS, SEEN = range(8)
COLUMNS = 8


@cached_njit
def _beside(shape: Any, x: float, y: float) -> float:
    """Signed distance of a point to a rectangle, without rounding [m]."""
    dx, dy = x - shape[X], y - shape[Y]
    u = abs(shape[COS] * dx + shape[SIN] * dy) - shape[HALF_X]
    v = abs(shape[COS] * dy - shape[SIN] * dx) - shape[HALF_Y]
    if u <= 0.0 or v <= 0.0:
        return max(u, v)
    return math.sqrt(u * u + v * v)


@cached_njit
def _corner(shape: Any, index: int) -> tuple[float, float]:
    a = shape[HALF_X] if index & 1 else -shape[HALF_X]
    b = shape[HALF_Y] if index & 2 else -shape[HALF_Y]
    return shape[X] + shape[COS] * a - shape[SIN] * b, shape[Y] + shape[SIN] * a + shape[COS] * b


@cached_njit
def _overlap(one: Any, other: Any) -> float:
    """Maximum gap between two rectangles along the axes of the first [m]; negative if both projections overlap."""
    dx, dy = other[X] - one[X], other[Y] - one[Y]
    c = abs(one[COS] * other[COS] + one[SIN] * other[SIN])
    s = abs(one[COS] * other[SIN] - one[SIN] * other[COS])
    u = abs(one[COS] * dx + one[SIN] * dy) - one[HALF_X] - (c * other[HALF_X] + s * other[HALF_Y])
    v = abs(one[COS] * dy - one[SIN] * dx) - one[HALF_Y] - (s * other[HALF_X] + c * other[HALF_Y])
    return max(u, v)


@cached_njit
def _between(one: Any, other: Any) -> float:
    """Signed distance of two shapes [m]."""
    rounding = one[RADIUS] + other[RADIUS]
    if one[HALF_X] == 0.0 and one[HALF_Y] == 0.0:
        return _beside(other, one[X], one[Y]) - rounding
    if other[HALF_X] == 0.0 and other[HALF_Y] == 0.0:
        return _beside(one, other[X], other[Y]) - rounding
    depth = max(_overlap(one, other), _overlap(other, one))
    if depth <= 0.0:
        return depth - rounding
    nearest = np.inf
    for index in range(4):
        x, y = _corner(one, index)
        nearest = min(nearest, _beside(other, x, y))
        x, y = _corner(other, index)
        nearest = min(nearest, _beside(one, x, y))
    return nearest - rounding


@cached_njit
def place(shapes: Any, parts: Any, first: int, last: int, x: float, y: float, angle: float) -> None:
    """Move the shapes `first` to `last` - 1 to a pose; the last rows of `shapes` belong to `parts`."""
    c, s = math.cos(angle), math.sin(angle)
    for index in range(first, last):
        part, shape = parts[index + len(parts) - len(shapes)], shapes[index]
        shape[X], shape[Y] = x + c * part[0] - s * part[1], y + s * part[0] + c * part[1]
        shape[COS], shape[SIN] = c, s


@cached_njit
def nearest(shapes: Any, first: int, last: int, outer: int, limit: float) -> float:
    """Return the minimum signed distance from a robot to all other shapes [m], or the limit.

    Args:
        shapes: All shapes (n, 8); the robot's are `first` to `last` - 1.
        first: Index of the robot's first shape.
        last: Index after its last shape.
        outer: Number of the robot's outer shapes, listed first, which enclose all others.
        limit: Distance to return if nothing is nearer [m].
    """
    for mine in range(first, first + outer):
        one = shapes[mine]
        reach = math.hypot(one[HALF_X], one[HALF_Y]) + one[RADIUS]
        for index in range(len(shapes)):
            if first <= index < last:
                continue
            other = shapes[index]
            if _beside(other, one[X], one[Y]) - reach - other[RADIUS] < limit:
                limit = min(limit, _between(one, other))
    return limit


@cached_njit
def _hit(shape: Any, x: float, y: float, dx: float, dy: float) -> float:
    """Return the fraction of a ray before a shape; 1 if the ray misses the shape or starts inside."""
    px, py = x - shape[X], y - shape[Y]
    radius = shape[RADIUS]
    if radius > 0.0:
        a, b = dx * dx + dy * dy, px * dx + py * dy
        c = px * px + py * py - radius * radius
        root = b * b - a * c
        if c < 0.0 or b >= 0.0 or root < 0.0:
            return 1.0
        return min(1.0, (-b - math.sqrt(root)) / a)
    begin, end = -np.inf, 1.0
    for axis in range(2):
        if axis == 0:
            p, d = shape[COS] * px + shape[SIN] * py, shape[COS] * dx + shape[SIN] * dy
            half = shape[HALF_X]
        else:
            p, d = shape[COS] * py - shape[SIN] * px, shape[COS] * dy - shape[SIN] * dx
            half = shape[HALF_Y]
        if d == 0.0:
            if abs(p) > half:
                return 1.0
            continue
        one, other = (-half - p) / d, (half - p) / d
        begin, end = max(begin, min(one, other)), min(end, max(one, other))
    return begin if 0.0 < begin <= end else 1.0


@cached_njit
def cast(shapes: Any, x: float, y: float, rays: Any, free: Any) -> None:
    """Write the free fraction of each ray (n, 2) from (x, y) into `free` (n,)."""
    order, away = np.empty(len(shapes), np.int64), np.empty(len(shapes))
    count = 0
    for index in range(len(shapes)):  # nearest shapes first, because they hide those behind them
        shape = shapes[index]
        if shape[SEEN] > 0.0:
            outer = shape[RADIUS] + math.hypot(shape[HALF_X], shape[HALF_Y])
            distance = math.hypot(shape[X] - x, shape[Y] - y) - outer
            place = count
            while place > 0 and away[place - 1] > distance:
                order[place], away[place] = order[place - 1], away[place - 1]
                place -= 1
            order[place], away[place] = index, distance
            count += 1
    for ray in range(len(rays)):
        least, length = 1.0, math.hypot(rays[ray, 0], rays[ray, 1])
        for place in range(count):
            if away[place] >= least * length:
                break
            least = min(least, _hit(shapes[order[place]], x, y, rays[ray, 0], rays[ray, 1]))
        free[ray] = least


@cached_njit
def wheel_speeds(speeds: Any, wanted: Any, own: float, shared: float, most: float) -> bool:
    """Drive two wheels (2,) towards their target speeds [rad/s] by limited impulses; return whether both reach them.

    Args:
        speeds: Speeds, changed in place.
        wanted: Target speeds (2,) [rad/s].
        own: Change in a wheel's speed per impulse on that wheel [rad/s per N m s].
        shared: Change in the other wheel's speed per impulse [rad/s per N m s].
        most: Maximum impulse [N m s].
    """
    left, right = wanted[0] - speeds[0], wanted[1] - speeds[1]
    first = second = 0.0
    for _ in range(50):  # Gauss-Seidel with limits; contracts by (shared / own)^2
        before = first
        first = min(max((left - shared * second) / own, -most), most)
        second = min(max((right - shared * first) / own, -most), most)
        if abs(first - before) <= 1e-12 * most:
            break
    speeds[0] += own * first + shared * second
    speeds[1] += own * second + shared * first
    return abs(speeds[0] - wanted[0]) + abs(speeds[1] - wanted[1]) < 1e-9
