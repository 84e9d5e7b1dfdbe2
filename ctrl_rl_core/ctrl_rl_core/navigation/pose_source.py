"""The pose of a robot in the map frame, from transforms or from a localiser's pose plus odometry."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from bisect import bisect_left
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.navigation.transform_tree import Transform, TransformError, TransformTree

Array = NDArray[np.float64]

POSE_SOURCES = ("tf", "amcl_pose")
"""Names of the sources: the transform from map to base, or the topic amcl_pose."""
FARTHEST_WITHOUT_POSE = 3.0
"""Maximum distance over which odometry alone is trusted after a localiser's pose [m]."""
_MOST_READINGS = 600
_NEAR_NS = 500_000_000


class OdometryTrack:
    """Recent odometry poses in stamp order."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._poses: list[Transform] = []
        self.heard = -math.inf
        self.frame = ""

    def update(self, message: Any, now: float) -> None:
        """Add a nav_msgs/Odometry received at a steady time [s].

        Raises:
            TransformError: A number is not finite, or the quaternion is not a rotation.
        """
        pose = Transform.from_message(message.pose.pose.position, message.pose.pose.orientation)
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        if self._stamps and stamp <= self._stamps[-1]:  # the simulation was restarted, or a clock was adjusted
            self._stamps, self._poses = [], []
        self._stamps.append(stamp)
        self._poses.append(pose)
        del self._stamps[:-_MOST_READINGS], self._poses[:-_MOST_READINGS]
        self.heard, self.frame = now, message.header.frame_id.lstrip("/")

    def latest(self) -> Transform:
        """Return the latest pose.

        Raises:
            TransformError: No odometry has been received.
        """
        if not self._poses:
            raise TransformError("no odometry yet")
        return self._poses[-1]

    def at(self, stamp: int) -> Transform:
        """Return the pose at a stamp [ns], or the nearest one within half a second.

        Raises:
            TransformError: The odometry does not cover that time.
        """
        place = bisect_left(self._stamps, stamp)
        if 0 < place < len(self._stamps):
            before, after = self._stamps[place - 1], self._stamps[place]
            return self._poses[place - 1].between(self._poses[place], (stamp - before) / (after - before))
        nearest = 0 if place == 0 else -1
        if not self._stamps or abs(self._stamps[nearest] - stamp) > _NEAR_NS:
            raise TransformError("no odometry of that time")
        return self._poses[nearest]


class PoseSource(ABC):
    """Provides the robot's pose in the map frame."""

    @abstractmethod
    def pose(self, now: float) -> Array:
        """Return the pose (3,) [m, m, rad] at a steady time [s].

        Raises:
            TransformError: The pose is unknown or too old.
        """

    @abstractmethod
    def frame_in_map(self, frame: str) -> Transform:
        """Return the pose of another frame in the map frame, for goals given in that frame.

        Raises:
            TransformError: The frame is unknown.
        """


class TransformPose(PoseSource):
    """Pose from the transform between map and base.

    Attributes:
        base: Frame of the robot; empty while it is unknown.

    Args:
        tree: Transforms received so far.
        map_frame: Frame of the map.
        timeout: Maximum age of a transform [s].
    """

    def __init__(self, tree: TransformTree, map_frame: str, timeout: float) -> None:
        self._tree, self._map, self._timeout = tree, map_frame, timeout
        self.base = ""

    def pose(self, now: float) -> Array:  # noqa: D102 - see PoseSource
        if not self.base:
            raise TransformError("no odometry yet, which provides the robot's frame")
        found = self._tree.lookup(self._map, self.base)
        age = self._tree.age(self._map, self.base, now)
        if not age <= self._timeout:
            raise TransformError(f"the transform from '{self._map}' to '{self.base}' is {age:.1f} s old")
        if conflict := self._tree.contradiction(self._map, self.base, now):
            raise TransformError(conflict)
        return found.pose

    def frame_in_map(self, frame: str) -> Transform:  # noqa: D102
        return self._tree.lookup(self._map, frame)


class LocaliserPose(PoseSource):
    """The last pose from a localiser, extrapolated by odometry.

    A localiser such as AMCL sends a pose only after the robot has moved, so an old pose may still be valid: the
    distance driven since counts, not the age.
    """

    def __init__(self, track: OdometryTrack, map_frame: str, timeout: float) -> None:
        self._track, self._map, self._timeout = track, map_frame, timeout
        self._correction: Transform | None = None
        self._from = np.zeros(3)

    def on_pose(self, message: Any) -> None:
        """Process a geometry_msgs/PoseWithCovarianceStamped.

        Raises:
            TransformError: The pose is in another frame, a number is not finite, or no odometry covers its time.
        """
        frame = message.header.frame_id.lstrip("/")
        if frame not in ("", self._map):
            raise TransformError(f"a pose in frame '{frame[:60]}': must be in '{self._map}'")
        pose = Transform.from_message(message.pose.pose.position, message.pose.pose.orientation)
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        then = self._track.at(stamp) if stamp else self._track.latest()
        self._correction, self._from = pose @ then.inverse(), then.translation

    def pose(self, now: float) -> Array:  # noqa: D102
        here = self._track.latest()
        age = now - self._track.heard
        if not age <= self._timeout:
            raise TransformError(f"the odometry is {age:.1f} s old")
        if self._correction is None:
            raise TransformError("no amcl_pose yet")
        way = float(np.linalg.norm(here.translation - self._from))
        if way > FARTHEST_WITHOUT_POSE:
            raise TransformError(f"no amcl_pose for {way:.1f} m")
        return (self._correction @ here).pose

    def frame_in_map(self, frame: str) -> Transform:  # noqa: D102
        if frame == self._map:
            return Transform.planar(0.0, 0.0, 0.0)
        if frame == self._track.frame and self._correction is not None:
            return self._correction
        raise TransformError(f"frame '{frame[:60]}' is unknown: amcl_pose gives the pose in '{self._map}' only")
