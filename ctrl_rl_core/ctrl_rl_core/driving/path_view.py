"""A path as a driver sees it: as a corridor in the scan, and as a goal ahead."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.sensing.scan import ScanGeometry, measured

Array = NDArray[np.float64]

_STEP = 0.05
"""Distance between the discs that make the corridor [m]."""
_BEHIND = 1.5
"""Length of the corridor behind the robot [m]."""
_BEYOND = 5.0
"""Length of the corridor ahead, also beyond the end of the path, so that no wall stands there [m]."""
_SEARCH = 1.0
"""Distance along the path within which the robot's place is looked for [m]: a path may cross itself."""


class PathView:
    """A path with the robot's place on it.

    Args:
        path: Positions (n, 2) [m], at least two places apart.
        half_width: Half width of the corridor [m].

    Attributes:
        length: Length of the path [m].
        place: Distance along the path of its point nearest to the robot [m].
        beside: Distance of the robot from the path [m].
    """

    def __init__(self, path: Array, half_width: float) -> None:
        self._half_width = half_width
        along = np.concatenate(((0.0,), np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))))
        self.length = float(along[-1])
        first, last = _direction(path, along, 0.0), _direction(path, along, self.length)
        # Straight on at both ends, so that the corridor is open there.
        path = np.vstack((path[0] - _BEHIND * first, path, path[-1] + _BEYOND * last))
        along = np.concatenate(((-_BEHIND,), along, (self.length + _BEYOND,)))
        self._along = np.arange(-_BEHIND, self.length + _BEYOND, _STEP)
        self._points = np.column_stack([np.interp(self._along, along, path[:, axis]) for axis in (0, 1)])
        self.place, self.beside, self._found = 0.0, math.inf, False

    @property
    def left(self) -> float:
        """Distance along the path to its end [m]."""
        return self.length - self.place

    def update(self, pose: Array) -> None:
        """Find the robot's place on the path by its pose (3,) [m, m, rad]: at first anywhere, then near the last."""
        low, high = (self.place - _SEARCH, self.place + _SEARCH) if self._found else (0.0, self.length)
        near = np.flatnonzero((self._along >= low) & (self._along <= min(high, self.length + _STEP)))
        away = np.hypot(*(self._points[near] - pose[:2]).T)
        best = int(np.argmin(away))
        self.place, self.beside, self._found = float(self._along[near[best]]), float(away[best]), True

    def ahead(self, distance: float) -> Array:
        """Return the pose (3,) [m, m, rad] on the path at a distance ahead of the robot, at most at the end."""
        i = int(np.searchsorted(self._along, min(self.place + distance, self.length)))
        dx, dy = self._points[i + 1] - self._points[i - 1]
        return np.array((*self._points[i], math.atan2(dy, dx)))

    def corridor(
        self, ranges: NDArray[np.float32], scan: ScanGeometry, pose: Array, lidar_x: float
    ) -> NDArray[np.float32]:
        """Return the ranges (n,) [m] of a scan in which walls stand beside the path.

        The corridor is the union of discs along the path. A beam ends where it leaves the last disc of a gapless row.

        Args:
            ranges: Ranges of the scan (n,) [m].
            scan: Bearings and limits of its beams.
            pose: Pose of the robot (3,) [m, m, rad].
            lidar_x: Position of the lidar ahead of the robot's centre [m].
        """
        c, s = math.cos(pose[2]), math.sin(pose[2])
        near = (self._along > self.place - _BEHIND) & (self._along < self.place + _BEYOND)
        discs = (self._points[near] - pose[:2]) @ np.array(((c, -s), (s, c))) - (lidar_x, 0.0)
        if self.beside > self._half_width - _STEP:  # a robot beside the corridor sees a bulge
            discs = np.vstack((discs, (0.0, 0.0)))
        bearings = scan.angle_min + scan.angle_increment * np.arange(scan.beams)
        along = np.outer(np.cos(bearings), discs[:, 0]) + np.outer(np.sin(bearings), discs[:, 1])
        chord = self._half_width**2 - ((discs**2).sum(axis=1) - along**2)
        half = np.sqrt(np.maximum(chord, 0.0))
        enters, leaves = np.where(chord > 0.0, along - half, np.inf), along + half
        order = np.argsort(enters, axis=1)
        enters = np.take_along_axis(enters, order, axis=1)
        reached = np.maximum.accumulate(np.take_along_axis(leaves, order, axis=1).clip(0.0), axis=1)
        gap = np.column_stack((enters[:, 1:] > reached[:, :-1], np.ones(len(bearings), bool)))
        walls = reached[np.arange(len(bearings)), gap.argmax(axis=1)]
        seen = measured(ranges, scan)
        return np.where(walls < np.minimum(np.nan_to_num(seen, nan=np.inf), scan.range_max), walls, ranges).astype(
            np.float32
        )


def _direction(path: Array, along: Array, at: float) -> Array:
    """Return the unit vector (2,) of a path near a distance along it."""
    low, high = max(at - 2.0 * _STEP, 0.0), min(at + 2.0 * _STEP, float(along[-1]))
    ends = np.array([[np.interp(each, along, path[:, axis]) for axis in (0, 1)] for each in (low, high)])
    step = ends[1] - ends[0]
    return np.asarray(step / max(float(np.hypot(*step)), 1e-9))
