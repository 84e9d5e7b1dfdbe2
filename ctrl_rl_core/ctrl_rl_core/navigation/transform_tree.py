"""Time-indexed transforms between frames, as in tf2 but without ROS; fed with tf2_msgs/TFMessage."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.navigation.transform_conflicts import TransformConflicts
from ctrl_rl_core.sensing.pose import PoseError, read_pose, yaw_of

Array = NDArray[np.float64]

MOST_FRAMES = 1000
"""Maximum number of frames; a robot has a few dozen."""
_MOST_SAMPLES = 1000
_LONGEST_NAME = 200
_SLACK_NS = 500_000_000
"""Extrapolation allowed before the first and after the last stamp of a transform [ns]."""


class TransformError(CtrlRlError):
    """A transform is missing, too old or invalid; the message gives the reason."""


@dataclass(frozen=True, eq=False)
class Transform:
    """The pose of a frame in its parent frame.

    Attributes:
        translation: Position of the frame's origin (3,) [m].
        rotation: Orientation as a unit quaternion x, y, z, w (4,).
    """

    translation: Array
    rotation: Array

    @classmethod
    def planar(cls, x: float, y: float, yaw: float) -> Transform:
        """Create a transform in the x-y plane [m, m, rad]."""
        rotation = np.array((0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)))
        return cls(np.array((x, y, 0.0)), rotation)

    @classmethod
    def from_message(cls, translation: Any, rotation: Any) -> Transform:
        """Create a transform from a message's translation or position, and quaternion.

        Raises:
            TransformError: A number is not finite or far too large, or the quaternion is not a rotation.
        """
        try:
            pose = read_pose(translation, rotation)
        except PoseError as error:
            raise TransformError(str(error)) from None
        return cls(pose[:3], pose[3:])

    def __matmul__(self, other: Transform) -> Transform:
        """Compose: apply `other` first, then this transform."""
        return Transform(
            self.translation + _rotate(self.rotation, other.translation), _multiply(self.rotation, other.rotation)
        )

    def inverse(self) -> Transform:
        """Return the inverse transform."""
        back = self.rotation * (-1.0, -1.0, -1.0, 1.0)
        return Transform(-_rotate(back, self.translation), back)

    @property
    def pose(self) -> Array:
        """Position and heading in the x-y plane (3,) [m, m, rad]."""
        return np.array((self.translation[0], self.translation[1], yaw_of(*self.rotation.tolist())))

    def between(self, other: Transform, share: float) -> Transform:
        """Interpolate to another transform at a fraction from 0 to 1, at constant speed and turn rate."""
        first, second = self.rotation, other.rotation
        cosine = float(first @ second)
        if cosine < 0.0:
            second, cosine = -second, -cosine
        angle = math.acos(min(cosine, 1.0))
        if angle < 1e-6:
            rotation = (1.0 - share) * first + share * second
        else:
            rotation = (math.sin((1.0 - share) * angle) * first + math.sin(share * angle) * second) / math.sin(angle)
        place = (1.0 - share) * self.translation + share * other.translation
        return Transform(place, rotation / np.linalg.norm(rotation))


@dataclass
class _Link:
    """Samples of the transform from a frame to its parent, in stamp order."""

    parent: str
    fixed: bool
    heard: float = -math.inf
    stamps: list[int] = field(default_factory=list)
    samples: list[Transform] = field(default_factory=list)

    def add(self, stamp: int, transform: Transform, memory: int) -> None:
        if self.stamps and abs(stamp - self.stamps[-1]) > memory:  # the clock was adjusted, or the simulation restarted
            self.stamps.clear()
            self.samples.clear()
        place = bisect_left(self.stamps, stamp)
        if place < len(self.stamps) and self.stamps[place] == stamp:
            self.samples[place] = transform
        else:
            self.stamps.insert(place, stamp)
            self.samples.insert(place, transform)
        old = max(bisect_left(self.stamps, self.stamps[-1] - memory), len(self.stamps) - _MOST_SAMPLES)
        if old > 0:
            del self.stamps[:old], self.samples[:old]

    def at(self, stamp: int | None) -> Transform:
        if stamp is None or self.fixed:
            return self.samples[-1]
        place = bisect_left(self.stamps, stamp)
        if 0 < place < len(self.stamps):
            before, after = self.stamps[place - 1], self.stamps[place]
            return self.samples[place - 1].between(self.samples[place], (stamp - before) / (after - before))
        nearest = 0 if place == 0 else -1
        apart = abs(self.stamps[nearest] - stamp)
        if apart > _SLACK_NS:
            when = "before the first" if place == 0 else "after the last"
            raise TransformError(f"{1e-9 * apart:.1f} s {when}")
        return self.samples[nearest]


class TransformTree:
    """Transforms of all frames received so far.

    Args:
        memory: Duration of the transform history [s].
    """

    def __init__(self, memory: float = 10.0) -> None:
        self._memory = round(1e9 * memory)
        self._links: dict[str, _Link] = {}
        self._conflicts = TransformConflicts()

    def update(self, message: Any, now: float, fixed: bool = False) -> str:
        """Process a tf2_msgs/TFMessage, and describe the transforms that were rejected; empty for none.

        Args:
            message: Message of /tf or /tf_static, from rclpy or from a bag.
            now: Steady time [s].
            fixed: Whether the message was received on /tf_static.
        """
        refused = ""
        for each in message.transforms:
            stamp = each.header.stamp.sec * 10**9 + each.header.stamp.nanosec
            try:
                transform = Transform.from_message(each.transform.translation, each.transform.rotation)
                self.set(each.header.frame_id, each.child_frame_id, transform, stamp, now, fixed)
            except TransformError as error:
                refused = f"{_short(each.header.frame_id)} to {_short(each.child_frame_id)}: {error}"
        return refused

    def set(self, parent: str, child: str, transform: Transform, stamp: int, now: float, fixed: bool = False) -> None:
        """Add one transform.

        Args:
            parent: Parent frame.
            child: Child frame.
            transform: Pose of the child in the parent.
            stamp: Stamp of the transform [ns].
            now: Steady time [s].
            fixed: Whether the transform is static.

        Raises:
            TransformError: A frame has no name, the frames would form a cycle, or there are too many frames.
        """
        parent, child = parent.lstrip("/"), child.lstrip("/")
        if not (parent and child) or max(len(parent), len(child)) > _LONGEST_NAME:
            raise TransformError("a frame has no name, or one that is too long")
        link = self._links.get(child)
        if link is None or link.parent != parent or link.fixed != fixed:
            if child in self._ancestors(parent):
                raise TransformError("the frames would form a cycle")
            if link is None and len(self._links) >= MOST_FRAMES:
                raise TransformError(f"more than {MOST_FRAMES} frames")
            link = self._links[child] = _Link(parent, fixed)
        self._conflicts.note(parent, child, transform.translation, float(transform.pose[2]), stamp, now, fixed)
        link.heard = now
        link.add(stamp, transform, self._memory)

    def lookup(self, target: str, source: str, stamp: int | None = None) -> Transform:
        """Return the pose of the frame `source` in the frame `target`.

        Args:
            target: Frame in which the pose is expressed.
            source: Frame whose pose is returned.
            stamp: Time of the pose [ns]; None for the latest of each link.

        Raises:
            TransformError: The frames are not connected, or a transform does not cover the time.
        """
        ups, downs = self._ways(target, source)
        out = Transform.planar(0.0, 0.0, 0.0)
        for frame in downs:
            out = self._at(frame, stamp) @ out
        back = Transform.planar(0.0, 0.0, 0.0)
        for frame in ups:
            back = self._at(frame, stamp) @ back
        return back.inverse() @ out

    def age(self, target: str, source: str, now: float) -> float:
        """Return the age of the oldest link between two frames [s]; static links do not count.

        Raises:
            TransformError: The frames are not connected.
        """
        links = [self._links[frame] for way in self._ways(target, source) for frame in way]
        return max((now - link.heard for link in links if not link.fixed), default=0.0)

    def contradiction(self, target: str, source: str, now: float) -> str:
        """Describe conflicts among the transforms between two frames at a steady time [s]; empty if there are none.

        Raises:
            TransformError: The frames are not connected.
        """
        return self._conflicts.fault([frame for way in self._ways(target, source) for frame in way], now)

    def _at(self, frame: str, stamp: int | None) -> Transform:
        link = self._links[frame]
        try:
            return link.at(stamp)
        except TransformError as error:
            raise TransformError(f"the transform from '{link.parent}' to '{frame}' was asked {error}") from None

    def _ancestors(self, frame: str) -> list[str]:
        """Return a frame and all its ancestors, nearest first."""
        out = [frame]
        while (link := self._links.get(out[-1])) is not None:
            out.append(link.parent)
        return out

    def _ways(self, target: str, source: str) -> tuple[list[str], list[str]]:
        """Return the frames from `target` and from `source` up to, but excluding, their common ancestor."""
        target, source = target.lstrip("/"), source.lstrip("/")
        above_target, above_source = self._ancestors(target), self._ancestors(source)
        shared = next((frame for frame in above_source if frame in above_target), None)
        if shared is None:
            known = [name for name in (target, source) if name in self._links or self._is_parent(name)]
            heard = f"heard of '{known[0]}' alone" if len(known) == 1 else f"{len(self._links)} other transforms heard"
            heard = "they lie in two trees" if len(known) == 2 else heard
            raise TransformError(f"no transform from '{_short(target)}' to '{_short(source)}' ({heard})")
        return above_target[: above_target.index(shared)], above_source[: above_source.index(shared)]

    def _is_parent(self, name: str) -> bool:
        return any(link.parent == name for link in self._links.values())


def _short(name: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in name[:60])


def _multiply(p: Array, q: Array) -> Array:
    """Return the product of two quaternions x, y, z, w."""
    a, b, c, d = p
    x, y, z, w = q
    return np.array(
        (
            d * x + a * w + b * z - c * y,
            d * y - a * z + b * w + c * x,
            d * z + a * y - b * x + c * w,
            d * w - a * x - b * y - c * z,
        )
    )


def _rotate(q: Array, point: Array) -> Array:
    """Rotate a point (3,) by a quaternion x, y, z, w."""
    axis, w = q[:3], q[3]
    cross = 2.0 * np.cross(axis, point)
    turned: Array = point + w * cross + np.cross(axis, cross)
    return turned
