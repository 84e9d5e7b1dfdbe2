"""Clearances and rays of many robots, compiled by Numba; robots do not see each other."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ctrl_rl_core.values import cached_njit

from sim_bridge.engines.planar_geometry import COS, HALF_X, HALF_Y, RADIUS, SEEN, SIN, X, Y, cast, nearest, place


@cached_njit
def clearances(shapes: Any, parts: Any, outer: int, places: Any, limit: float, out: Any) -> None:
    """Write the distance of each robot to the nearest shape [m], or the limit, into `out` (N,).

    Args:
        shapes: Standing shapes (n, 8), then room for the robot's (m, 8).
        parts: Shapes of the robot (m, 7).
        outer: Number of the robot's shapes, the first ones, that hold all others.
        places: Positions and counter-clockwise angles of the robots (N, 3) [m, m, rad].
        limit: Distance to write if nothing is nearer [m].
        out: Signed distances (N,), written.
    """
    first, last = len(shapes) - len(parts), len(shapes)
    for i in range(len(places)):
        place(shapes, parts, first, last, places[i, 0], places[i, 1], places[i, 2])
        out[i] = nearest(shapes, first, last, outer, limit)


@cached_njit
def scans(standing: Any, origins: Any, bearings: Any, reach: float, out: Any) -> None:
    """Write the ranges of each robot [m], infinite where a ray hits nothing, into `out` (N, beams).

    Args:
        standing: Standing shapes (n, 8).
        origins: Positions and counter-clockwise angles of the lidars (N, 3) [m, m, rad].
        bearings: Bearings of the beams, counter-clockwise (beams,) [rad].
        reach: Length of a ray [m].
        out: Ranges, written; 0 for a lidar inside a shape.
    """
    rays = np.empty((len(bearings), 2))
    for i in range(len(origins)):
        x, y, angle = origins[i, 0], origins[i, 1], origins[i, 2]
        if _buried(standing, x, y):
            out[i] = 0.0
            continue
        for beam in range(len(bearings)):
            rays[beam, 0] = reach * math.cos(angle + bearings[beam])
            rays[beam, 1] = reach * math.sin(angle + bearings[beam])
        cast(standing, x, y, rays, out[i])
        for beam in range(len(bearings)):
            out[i, beam] = out[i, beam] * reach if out[i, beam] < 1.0 else np.inf


@cached_njit
def _buried(standing: Any, x: float, y: float) -> bool:
    """Whether a point lies inside a shape that rays hit."""
    for index in range(len(standing)):
        shape = standing[index]
        dx, dy = x - shape[X], y - shape[Y]
        u = max(0.0, abs(shape[COS] * dx + shape[SIN] * dy) - shape[HALF_X])
        v = max(0.0, abs(shape[COS] * dy - shape[SIN] * dx) - shape[HALF_Y])
        if shape[SEEN] > 0.0 and (math.hypot(u, v) < shape[RADIUS] or (u == 0.0 and v == 0.0)):
            return True
    return False
