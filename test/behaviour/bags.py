"""A bag of a robot that drives along a straight corridor from lidar, computed here: the same on every machine."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from case import Case
from digests import Parts, bag_parts
from messages import Bag, header

STEP = 200_000_000
"""Time between two scans [ns]."""
BEGIN = 1_000_000_000_000
_BEAMS = 360
_HALF_WIDTH = 0.4
_RANGE = 3.5
_TOPICS = {
    "/scan": "sensor_msgs/msg/LaserScan",
    "/odom": "nav_msgs/msg/Odometry",
    "/cmd_vel": "geometry_msgs/msg/TwistStamped",
}


def write_drive(folder: Path, scans: int = 300, seed: int = 0) -> None:
    """Write a bag with scan, odometry and the command that answers each scan.

    Args:
        folder: New folder of the bag.
        scans: How many scans it holds.
        seed: Seed of what is added to the commands.
    """
    random = np.random.default_rng(seed)
    x, y, theta, v, omega = -2.0, 0.1, 0.2, 0.0, 0.0
    with Bag(folder, _TOPICS) as bag:
        for number in range(scans):
            time = BEGIN + number * STEP
            dt = 1e-9 * STEP
            x, y, theta = x + dt * v * math.cos(theta), y + dt * v * math.sin(theta), theta + dt * omega
            if x > 2.0:  # a corridor without end
                x -= 4.0
            pose = {
                "position": {"x": x, "y": y},
                "orientation": {"z": math.sin(theta / 2), "w": math.cos(theta / 2)},
            }
            twist = {"linear": {"x": v}, "angular": {"z": omega}}
            bag.put(
                "/odom",
                time,
                header=header(time, "odom"),
                child_frame_id="base_footprint",
                pose={"pose": pose, "covariance": np.zeros(36)},
                twist={"twist": twist, "covariance": np.zeros(36)},
            )
            bag.put("/scan", time + 1, header=header(time, "base_scan"), **_scan(y, theta))
            v = 0.18 + 0.03 * random.standard_normal()
            omega = -4.0 * y - 2.0 * theta + 0.3 * random.standard_normal()
            omega = min(1.0, max(-1.0, omega))
            answer = {"linear": {"x": v}, "angular": {"z": omega}}
            bag.put("/cmd_vel", time + 2, header=header(time, "base_footprint"), twist=answer)


def _scan(y: float, theta: float) -> dict[str, object]:
    """Return the fields of a scan between two walls along x."""
    sine = np.sin(theta + np.arange(_BEAMS) * (math.tau / _BEAMS))
    wall = np.where(sine > 0.0, _HALF_WIDTH - y, _HALF_WIDTH + y)
    with np.errstate(divide="ignore"):
        ranges = np.minimum(wall / np.abs(sine), _RANGE)
    return {
        "angle_max": math.tau * (_BEAMS - 1) / _BEAMS,
        "angle_increment": math.tau / _BEAMS,
        "scan_time": 1e-9 * STEP,
        "range_min": 0.12,
        "range_max": _RANGE,
        "ranges": ranges.astype(np.float32),
    }


def _drive(folder: Path) -> dict[str, Parts]:
    write_drive(folder / "drive")
    return {"": bag_parts(folder / "drive")[0]}


def _cut(folder: Path) -> dict[str, Parts]:
    """Leave the first part of the drive's file, as after a power cut."""
    (file,) = (folder / "drive").glob("*.mcap")
    (folder / "cut").mkdir()
    (folder / "cut" / "cut.mcap").write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    return {}


BAGS = (Case("drive", work=_drive), Case("cut", work=_cut, after=("drive",)))
