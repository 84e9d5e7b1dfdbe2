"""Messages of the navigator: goals in; status, path and value out."""

from __future__ import annotations

import math

import numpy as np
from builtin_interfaces.msg import Time
from ctrl_rl_core.navigation import Transform
from ctrl_rl_core.ros import as_percent
from geometry_msgs.msg import Pose, PoseStamped
from nav_msgs.msg import OccupancyGrid, Path
from numpy.typing import NDArray
from std_msgs.msg import Header

from ctrl_rl_core import OccupancyMap, PoseError, read_goal
from ctrl_rl_msgs.msg import NavigatorStatus
from ctrl_rl_navigation.cars import CarNavigator, CarValue
from ctrl_rl_navigation.driving.decision import Decision, Goal
from ctrl_rl_navigation.driving.navigator import Navigator
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.values.map_value import MapValue

_PATH_STEP, _PATH_POSES = 5, 200
"""Minimum stride of the path positions in a path message, and maximum number of its poses."""
_SLICE_CELLS = 1_000_000
"""Maximum number of cells in a map of times."""


def goal_from(message: PoseStamped, frame: Transform, with_heading: bool) -> Goal:
    """Parse a goal message.

    Args:
        message: Goal in its own frame.
        frame: Pose of that frame in the map frame.
        with_heading: Whether to use the heading; a message without an orientation has none.

    Raises:
        NavigationError: The pose is invalid.
    """
    try:
        goal = read_goal(message.pose)
    except PoseError as error:
        raise NavigationError(str(error)) from None
    turned = bool(goal[3:].any())
    rotation = goal[3:] if turned else np.array((0.0, 0.0, 0.0, 1.0))
    x, y, heading = (frame @ Transform(np.array((*goal[:2], 0.0)), rotation)).pose.tolist()
    return Goal((x, y), heading if turned and with_heading else None)


def status_message(navigator: Navigator | CarNavigator, decision: Decision, header: Header) -> NavigatorStatus:
    """Convert the navigator's decision to a status message."""
    out = NavigatorStatus(header=header, state=int(decision.state), message=decision.message)
    if navigator.goal is not None:
        out.goal = planar_pose(*navigator.goal.position, navigator.goal.heading or 0.0)
    out.remaining_time = decision.remaining_time
    out.remaining_distance = navigator.remaining_distance
    out.solving = navigator.solving
    return out


def path_message(path: NDArray[np.float64], header: Header) -> Path:
    """Convert a path (n, 2) [m] to a message; poses point along the path."""
    step = max(_PATH_STEP, math.ceil(len(path) / _PATH_POSES))
    places = np.concatenate((path[:-1:step], path[-1:])) if len(path) else path
    steps = np.diff(places, axis=0)
    headings = np.arctan2(steps[:, 1], steps[:, 0]).tolist() if len(places) > 1 else []
    headings += headings[-1:] or [0.0]
    out = Path(header=header)
    out.poses = [
        PoseStamped(header=header, pose=planar_pose(x, y, heading))
        for (x, y), heading in zip(places.tolist(), headings, strict=False)
    ]
    return out


def slice_message(value: MapValue | CarValue, stamp: Time, frame: str) -> OccupancyGrid:
    """Convert a value to a map: 0 at the goal, 100 at the maximum time, -1 where unreachable.

    Of a large map, only each second, third, ... row and column is shown: converting all would delay commands.
    """
    step = math.ceil(math.sqrt(value.times.size / _SLICE_CELLS))
    first = step // 2
    shown = as_percent(value.times[first::step, first::step])
    return OccupancyMap(shown, step * value.map.resolution, value.map.origin).to_message(stamp, frame)


def planar_pose(x: float, y: float, yaw: float) -> Pose:
    """Return a pose message in the x-y plane [m, m, rad]."""
    out = Pose()
    out.position.x, out.position.y = x, y
    out.orientation.z, out.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    return out
