"""Serialized messages of a drive, without an installed ROS graph: what a recorder would have written."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_bags.datasets.frames import ScanLayout
from ctrl_rl_bags.format.metadata import Topic
from ctrl_rl_bags.recording.message_types import message_definition
from ctrl_rl_bags.recording.typestore import typestore

SCAN_TYPE, ODOMETRY_TYPE = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
GOAL_TYPE, IMAGE_TYPE = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/Image"
REWARD_TYPE, EPISODE_TYPE = "ctrl_rl_msgs/msg/TaskReward", "ctrl_rl_msgs/msg/EpisodeStatus"
_OWN = (REWARD_TYPE, EPISODE_TYPE, "ctrl_rl_msgs/msg/RotorThrusts")


class MessageMaker:
    """Makes the CDR bytes of messages, all stamped in one frame.

    Args:
        odometry_frame: Frame of odometry and goals.
        body_frame: Frame of the robot's body.
    """

    def __init__(self, odometry_frame: str = "odom", body_frame: str = "base_footprint") -> None:
        self._store = typestore(*_OWN)
        self._odometry_frame, self._body_frame = odometry_frame, body_frame
        self._no_covariance = np.zeros(36)
        self._no_intensities = np.empty(0, np.float32)

    def topic(self, name: str, kind: str) -> Topic:
        """Return a topic with the definition and the hash of its type."""
        return Topic(name, kind, message_definition(kind), self._store.hash_rihs01(kind))

    def scan(self, stamp: int, ranges: NDArray[np.float32], layout: ScanLayout) -> bytes:
        """Return a LaserScan of ranges (beams,) [m]."""
        return self._bytes(
            SCAN_TYPE,
            self._header(stamp, layout.frame or self._body_frame),
            layout.angle_min,
            layout.angle_min + layout.angle_increment * (layout.beams - 1),
            layout.angle_increment,
            0.0,
            0.0,
            layout.range_min,
            layout.range_max,
            np.ascontiguousarray(ranges),
            self._no_intensities,
        )

    def odometry(self, stamp: int, numbers: ArrayLike) -> bytes:
        """Return an Odometry of pose and twist (13,), see `ODOMETRY_NAMES`."""
        it = np.asarray(numbers, dtype=np.float64).tolist()
        types = self._store.types
        pose = types["geometry_msgs/msg/PoseWithCovariance"](self._pose(it[:3], it[3:7]), self._no_covariance)
        twist = types["geometry_msgs/msg/TwistWithCovariance"](self._twist(it[7:10], it[10:]), self._no_covariance)
        return self._bytes(ODOMETRY_TYPE, self._header(stamp, self._odometry_frame), self._body_frame, pose, twist)

    def command(self, stamp: int, command: ArrayLike, kind: str) -> bytes:
        """Return a command (2,) as a message of the type `kind`, one of `COMMAND_TYPES`."""
        first, second = np.asarray(command, dtype=np.float64).tolist()
        if kind.endswith("RotorThrusts"):
            return self._bytes(kind, self._header(stamp, self._body_frame), first, second)
        twist = self._twist((first, 0.0, 0.0), (0.0, 0.0, second))
        if kind.endswith("TwistStamped"):
            return self._bytes(kind, self._header(stamp, self._body_frame), twist)
        return bytes(self._store.serialize_cdr(twist, kind))

    def goal(self, stamp: int, goal: ArrayLike) -> bytes:
        """Return a PoseStamped of position and attitude (7,), see `GOAL_NAMES`."""
        it = np.asarray(goal, dtype=np.float64).tolist()
        return self._bytes(GOAL_TYPE, self._header(stamp, self._odometry_frame), self._pose(it[:3], it[3:]))

    def reward(self, stamp: int, reward: float, outcome: int) -> bytes:
        """Return a TaskReward, its time to reach unknown."""
        return self._bytes(
            REWARD_TYPE, self._header(stamp, self._odometry_frame), self._outcome(outcome), reward, float("nan")
        )

    def episode(self, stamp: int, number: int, outcome: int, seed: int = 0, elapsed: float = 0.0) -> bytes:
        """Return an EpisodeStatus; what it says of clearance and progress is unknown."""
        nothing = float("nan")
        return self._bytes(
            EPISODE_TYPE,
            self._header(stamp, self._odometry_frame),
            number,
            seed,
            elapsed,
            *(nothing, nothing, nothing),
            self._outcome(outcome),
        )

    def image(self, stamp: int, picture: NDArray[np.uint8]) -> bytes:
        """Return an Image of a picture (height, width, 3), red first."""
        height, width, _ = picture.shape
        data = np.ascontiguousarray(picture).reshape(-1)
        return self._bytes(IMAGE_TYPE, self._header(stamp, "camera"), height, width, "rgb8", 0, 3 * width, data)

    def _bytes(self, kind: str, *fields: Any) -> bytes:
        return bytes(self._store.serialize_cdr(self._store.types[kind](*fields), kind))

    def _header(self, stamp: int, frame: str) -> Any:
        types = self._store.types
        time = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
        return types["std_msgs/msg/Header"](time, frame)

    def _outcome(self, outcome: int) -> Any:
        return self._store.types["ctrl_rl_msgs/msg/TaskOutcome"](value=outcome)

    def _pose(self, position: Any, orientation: Any) -> Any:
        types = self._store.types
        return types["geometry_msgs/msg/Pose"](
            types["geometry_msgs/msg/Point"](*position), types["geometry_msgs/msg/Quaternion"](*orientation)
        )

    def _twist(self, linear: Any, angular: Any) -> Any:
        vector, kind = self._store.types["geometry_msgs/msg/Vector3"], self._store.types["geometry_msgs/msg/Twist"]
        return kind(vector(*linear), vector(*angular))
