"""Mounting direction of a lidar from the bag's tf_static; a TurtleBot 4's points to the left."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_bags.alignment import Tell, warn
from ctrl_rl_bags.format import fields_of
from ctrl_rl_core.io import one_line
from numpy.typing import NDArray

from ctrl_rl_bags import bag_info, read_messages
from koopman_lqr_controller.errors import KoopmanError

_BASES = ("base_link", "base_footprint")
_LEVEL = 0.99
"""Minimum cosine of the lidar's tilt for a planar scan."""


def yaw_of_lidar(bag: Path, scan: str, robot: str = "", tell: Tell = warn) -> float:
    """Return the direction of a scan's zero bearing in the robot's frame [rad]; 0 without tf_static in the bag.

    Args:
        bag: Bag, with or without the topic tf_static.
        scan: Topic of the scans.
        robot: Namespace of the robot, for its own tf_static.
        tell: Called with a line if the mounting is unknown; a warning by default.

    Raises:
        KoopmanError: The lidar is upside down or tilted, or tf_static lacks its mounting.
        BagError: The bag cannot be read.
    """
    known = bag_info(bag).topics
    topics = [name for name in dict.fromkeys((f"/{robot.strip('/')}/tf_static", "/tf_static")) if name in known]
    turns: dict[str, tuple[str, Any]] = {}
    with fields_of(f"{bag}: a message of {scan} or tf_static"):
        frame = next((message.data.header.frame_id for message in read_messages(bag, [scan])), "")
        for message in read_messages(bag, topics) if topics else ():
            for transform in message.data.transforms:
                turns[transform.child_frame_id] = (transform.header.frame_id, transform.transform.rotation)
    if not turns:
        if frame.rpartition("/")[2] not in ("", *_BASES):
            tell(
                f"{bag}: no tf_static says how {one_line(frame, 200)} is mounted: the lidar is taken to look ahead "
                "(--lidar-yaw)"
            )
        return 0.0
    axes = np.eye(3)
    while frame.rpartition("/")[2] not in _BASES:
        if frame not in turns:
            raise KoopmanError(f"{bag}: tf_static does not lead from the scan to a base, only to {frame}: --lidar-yaw?")
        frame, q = turns.pop(frame)
        axes = _rotation(q.w, q.x, q.y, q.z) @ axes
    if axes[2, 2] < _LEVEL:
        raise KoopmanError(f"{bag}: the lidar does not lie flat and upright on the robot: give --lidar-yaw if it does")
    return float(np.arctan2(axes[1, 0], axes[0, 0]))


def _rotation(w: float, x: float, y: float, z: float) -> NDArray[np.float64]:
    """Return the matrix of a unit quaternion."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
