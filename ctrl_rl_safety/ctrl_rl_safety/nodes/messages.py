"""Messages of the safety filter: its actions and reasons, a picture of the recoverable set, and the escape."""

from __future__ import annotations

from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from ctrl_rl_safety.filter.verdict import Mode
from ctrl_rl_safety.sets.recoverable_set import RecoverableSet

Array = NDArray[np.float64]

_MUCH = 0.5
"""Margin at which a cell of the picture counts as free [m]."""
_LOST, _TIGHTEST = 100, 90
"""Values of cells that are not recoverable, and of recoverable cells without margin."""
_COLOURS = {
    Mode.PASSED: (0.2, 0.7, 0.3),
    Mode.CORRECTED: (0.95, 0.7, 0.1),
    Mode.ESCAPING: (0.85, 0.15, 0.15),
    Mode.UNBLOCKING: (0.2, 0.4, 0.9),
    Mode.EVADING: (0.6, 0.3, 0.8),
}
WHY = {
    Mode.PASSED: "",
    Mode.CORRECTED: "the raw command has no certified escape: the nearest command that has one is sent",
    Mode.ESCAPING: "no command has a certified escape: full braking",
    Mode.UNBLOCKING: "the robot was blocked for long: it turns to the side with more room",
    Mode.EVADING: "a mover is approaching: the robot moves out of the way",
}


def slice_message(found: RecoverableSet, theta: float, v: float, stamp: Time, frame: str) -> OccupancyGrid:
    """Convert a slice of a recoverable set to a map: 100 not recoverable, 90 no margin, 0 half a metre or more.

    Args:
        found: Recoverable set.
        theta: Heading of the slice [rad].
        v: Speed of the slice [m/s].
        stamp: Time stamp of the message.
        frame: Frame of the set.
    """
    margins = found.slice_at(theta, v)
    shown = np.round(_TIGHTEST * (1.0 - np.clip(margins / _MUCH, 0.0, 1.0)))
    out: Any = OccupancyGrid(header=Header(stamp=stamp, frame_id=frame))
    out.info.map_load_time, out.info.resolution = stamp, float(found.cell)
    out.info.height, out.info.width = margins.shape
    out.info.origin.position.x, out.info.origin.position.y = found.x - 0.5 * found.cell, found.y - 0.5 * found.cell
    out.info.origin.orientation.w = 1.0
    out.data.frombytes(np.where(margins < 0.0, _LOST, shown).astype(np.int8).tobytes())
    return out


def escape_marker(path: Array, mode: Mode, width: float, stamp: Time, frame: str) -> Marker:
    """Return the positions of an escape (n, 5) as a line as wide as the robot [m], in the colour of its mode."""
    out = Marker(header=Header(stamp=stamp, frame_id=frame), ns="escape", type=Marker.LINE_STRIP)
    out.action = Marker.ADD if len(path) > 1 else Marker.DELETE
    out.pose.orientation.w = 1.0
    out.scale.x = width
    red, green, blue = _COLOURS[mode]
    out.color = ColorRGBA(r=red, g=green, b=blue, a=0.5)
    out.points = [Point(x=x, y=y) for x, y in path[:, :2].tolist()]
    return out
