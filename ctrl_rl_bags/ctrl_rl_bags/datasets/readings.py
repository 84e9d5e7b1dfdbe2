"""Converts the messages of a drive to arrays."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ctrl_rl_core.sensing import nearest_beams
from numpy.typing import NDArray

from ctrl_rl_bags.datasets.frames import GOAL_NAMES, ImageLayout, ScanLayout, is_usable
from ctrl_rl_bags.format.checks import BagError, printable
from ctrl_rl_core import PoseError, ScanGeometry, read_scan
from ctrl_rl_core import read_goal as core_read_goal

Array = NDArray[np.float64]
_COLOURS = {
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "mono8": (1, (0, 0, 0)),
}
"""Channels of an image encoding, and the positions of red, green and blue among them."""
_SAME_ANGLE = 1e-3
"""Angular difference below which scans have the same beams [rad]."""
_SAME_FIELD = 0.1
"""Difference in field of view below which scans come from one lidar with a varying number of beams [rad]."""


def stamp_of(message: Any) -> int:
    """Return a message's header stamp [ns]."""
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def read_command(message: Any, kind: str) -> Array | None:
    """Return a command (2,): speed and turn rate, or two thrusts; None if not finite."""
    if kind.endswith("RotorThrusts"):
        command = np.array((message.t1, message.t2), dtype=np.float64)
    else:
        twist = message.twist if kind.endswith("TwistStamped") else message
        command = np.array((twist.linear.x, twist.angular.z), dtype=np.float64)
    return command if is_usable(command) else None


def read_goal(message: Any) -> Array:
    """Return position and attitude of a goal (7,); NaN if the pose is invalid."""
    try:
        return core_read_goal(message.pose)
    except PoseError:
        return no_goal()


def no_goal() -> Array:
    """Return the row that represents no goal (7,): NaN."""
    return np.full(len(GOAL_NAMES), math.nan)


def read_image(message: Any, layout: ImageLayout | None, what: str) -> NDArray[np.uint8]:
    """Return an image (height, width, 3) in RGB order.

    Raises:
        BagError: The encoding is unknown, the size differs from the first image, or bytes are missing.
    """
    height, width, encoding = int(message.height), int(message.width), str(message.encoding)
    if encoding not in _COLOURS:
        raise BagError(f"{what} has the encoding {printable(encoding, 40)}: must be one of {', '.join(_COLOURS)}")
    if layout is not None and (height, width) != (layout.height, layout.width):
        raise BagError(f"{what} has {width} x {height} pixels, the first {layout.width} x {layout.height}")
    channels, order = _COLOURS[encoding]
    data = np.asarray(message.data, dtype=np.uint8)
    if int(message.step) < width * channels or len(data) < height * int(message.step):
        raise BagError(f"{what} of {width} x {height} pixels has {len(data)} bytes only")
    rows = data[: height * int(message.step)].reshape(height, -1)[:, : width * channels]
    return np.ascontiguousarray(rows.reshape(height, width, channels)[..., order])


class ScanColumn:
    """Resamples the scans of a dataset to the beams of the first one.

    Attributes:
        layout: Beams of all scans; None before the first.
    """

    def __init__(self, beams: int | None, layout: ScanLayout | None = None) -> None:
        """Set the beams to which scans are resampled.

        Args:
            beams: Number of beams; None for that of the first scan.
            layout: Beams of the first scan, if known.
        """
        self.layout = layout
        self._beams = beams

    def read(self, message: Any, what: str) -> NDArray[np.float32]:
        """Return the ranges (beams,) [m] of a scan; some lidars, such as the LDS-02, vary their number of beams.

        Raises:
            BagError: The field of view differs from that of the first scan, and no number of beams was given.
            ScanError: The scan is invalid.
        """
        ranges, scan = read_scan(message)
        scan.check()
        if self.layout is None:
            self.layout = self._first(scan, str(message.header.frame_id))
        layout = self.layout
        last = scan.angle_min + scan.angle_increment * scan.beams
        usual = layout.angle_min + layout.angle_increment * layout.beams
        apart = max(abs(scan.angle_min - layout.angle_min), abs(last - usual))
        if scan.beams == layout.beams and apart <= _SAME_ANGLE:
            return ranges
        if self._beams is None and apart > _SAME_FIELD:
            raise BagError(
                f"{what} has {scan.beams} beams from {scan.angle_min:.4f} rad, the first has {layout.beams} from "
                f"{layout.angle_min:.4f} rad: of another lidar? --beams N brings all scans to N beams of the first"
            )
        bearings = layout.angle_min + layout.angle_increment * np.arange(layout.beams, dtype=np.float64)
        field, nearest = nearest_beams(scan, bearings)
        return np.where(field, ranges[nearest], np.float32(np.nan))

    def _first(self, scan: ScanGeometry, frame: str) -> ScanLayout:
        beams = self._beams or scan.beams
        return ScanLayout(
            beams=beams,
            angle_min=scan.angle_min,
            angle_increment=float(np.float32(scan.angle_increment * scan.beams / beams)),  # as in the message
            range_min=scan.range_min,
            range_max=min(scan.range_max, 1e30),
            frame=printable(frame),
        )
