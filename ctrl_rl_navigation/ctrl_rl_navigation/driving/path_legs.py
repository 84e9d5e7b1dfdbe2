"""A given path as goals, each with the stretch of the path that leads to it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_navigation.driving.decision import Goal
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.values.map_value import path_length
from ctrl_rl_navigation.values.path_corridor import resample

Array = NDArray[np.float64]

_STEP = 0.1
"""Distance between the points of a stretch [m]."""
_OVERLAP = 1.0
"""Length by which a stretch begins before the end of the one before [m]."""
_BETWEEN = 0.7
"""Distance between two corridors over which the value still leads from one into the other [m]."""
_LONGEST = 1000.0


class Leg(NamedTuple):
    """A goal, and the length of the way to it from the goal before [m]."""

    goal: Goal
    length: float


def legs_to(goals: list[Goal]) -> list[Leg]:
    """Return legs to goals in order; a length is that of the straight line."""
    places = np.array([goal.position for goal in goals])
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1).tolist()
    return [Leg(goal, length) for goal, length in zip(goals, [0.0, *lengths], strict=True)]


def legs_along(path: Array, heading: float | None, corridor: float, pose: Array | None) -> list[Leg]:
    """Cut a path where it comes back beside itself, so that no stretch's corridor has a short cut.

    Args:
        path: Positions in the map frame (n, 2) [m].
        heading: Heading at the end [rad]; None for any.
        corridor: Half width of the corridor [m].
        pose: Pose of the robot (3,) [m, m, rad], which joins the first stretch; None if unknown.

    Raises:
        NavigationError: The path is empty, too long, or not finite.
    """
    if not (len(path) and np.isfinite(path).all()):
        raise NavigationError("the path has no poses, or one that is not finite")
    if not path_length(path) <= _LONGEST:
        raise NavigationError(f"the path is longer than {_LONGEST:g} m")
    points, apart = resample(path, _STEP), 2.0 * corridor + _BETWEEN
    if pose is not None:
        first = points[: min((*_cuts(points, apart), len(points)))]
        nearest = int(np.argmin(np.hypot(*(first - pose[:2]).T)))
        points = resample(np.vstack((pose[:2], points[nearest:])), _STEP)
    legs, begin = list[Leg](), 0
    for end in (*_cuts(points, apart), len(points)):
        stretch = points[max(begin - round(_OVERLAP / _STEP), 0) : end]
        x, y = stretch[-1].tolist()
        goal = Goal((x, y), heading if end == len(points) else None, tuple(map(tuple, stretch.tolist())))
        legs.append(Leg(goal, path_length(points[max(begin - 1, 0) : end])))
        begin = end
    return legs


def _cuts(points: Array, apart: float) -> list[int]:
    """Return the indices of points at which another stretch begins: the next point is too near to an earlier one.

    Args:
        points: Positions along a path at steps of `_STEP` (n, 2) [m].
        apart: Minimum distance between two places of a stretch [m], unless the way between them is short.
    """
    near_by, cuts, begin = round(2.0 * apart / _STEP), list[int](), 0
    for i in range(len(points)):
        before = points[begin : max(i - near_by + 1, begin)]
        if len(before) and float(np.hypot(*(before - points[i]).T).min()) < apart:
            cuts.append(i)
            begin = i
    return cuts
