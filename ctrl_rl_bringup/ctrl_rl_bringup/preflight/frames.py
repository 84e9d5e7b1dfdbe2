"""The frames of /tf and /tf_static, as links from parent to child."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from ctrl_rl_core.navigation import TransformConflicts
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class Link:
    """The last transform from one frame to the next.

    Attributes:
        parent: Frame that the transform is given in.
        child: Frame that it places.
        matrix: Pose of the child in the parent (4, 4) [m].
        age: Age of its stamp on arrival [s]; NaN for a static one.
        static: Whether it came on /tf_static.
    """

    parent: str
    child: str
    matrix: Matrix
    age: float
    static: bool


class FrameTree:
    """Links between frames; a child with two parents keeps both, because that is a fault.

    Attributes:
        conflicts: Detector of transforms with two publishers.
        conflict: First contradiction between transforms; empty for none.
    """

    def __init__(self) -> None:
        self.conflicts, self.conflict = TransformConflicts(), ""
        self._links: dict[str, dict[str, Link]] = {}

    def add(self, link: Link) -> None:
        """Add a link, replacing the former one between the two frames."""
        of_child = self._links.setdefault(link.child, {})
        of_child.pop(link.parent, None)
        of_child[link.parent] = link  # the last one heard is the last one

    def __iter__(self) -> Iterator[Link]:
        return (link for links in self._links.values() for link in links.values())

    def parents(self, frame: str) -> tuple[str, ...]:
        """Return the parents of a frame, in order."""
        return tuple(sorted(self._links.get(frame, {})))

    def link(self, parent: str, child: str) -> Link | None:
        """Return the link between two frames, or None."""
        return self._links.get(child, {}).get(parent)

    def between(self, target: str, source: str) -> Matrix | None:
        """Return the pose (4, 4) [m] of frame `source` in frame `target`; None if they are not connected."""
        up, down = self._to_ancestors(target), self._to_ancestors(source)
        common = next((frame for frame in down if frame in up), None)
        return None if common is None else np.linalg.inv(up[common]) @ down[common]

    def _to_ancestors(self, frame: str) -> dict[str, Matrix]:
        """Return the pose (4, 4) of a frame in itself and in each of its ancestors, the nearest first."""
        out, pose = {frame: np.eye(4)}, np.eye(4)
        while links := self._links.get(frame):
            link = next(reversed(links.values()))
            frame, pose = link.parent, link.matrix @ pose
            if frame in out:
                break
            out[frame] = pose
        return out


def pose_matrix(translation: tuple[float, float, float], rotation: tuple[float, float, float, float]) -> Matrix | None:
    """Return a pose as a matrix (4, 4); None if it is not finite or the quaternion x, y, z, w is zero."""
    x, y, z, w = rotation
    norm = float(np.linalg.norm(rotation))
    if not (np.isfinite(translation).all() and np.isfinite(norm) and norm > 1e-6):
        return None
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    out = np.eye(4)
    out[:3, :3] = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )
    out[:3, 3] = translation
    return out


def planar_pose(matrix: Matrix) -> tuple[float, float, float]:
    """Return x, y and yaw [m, m, rad] of a pose (4, 4)."""
    return float(matrix[0, 3]), float(matrix[1, 3]), float(np.arctan2(matrix[1, 0], matrix[0, 0]))
