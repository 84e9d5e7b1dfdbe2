"""Plane geometry of tasks: boxes, discs and curved corridors, with exact signed distances.

Coordinates are in the task's plane, (x, y) or (x, z), in metres, in the frame `map`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_SHORTEST_WALL = 1e-3
"""Length below which a rest of a wall beside an opening is left out [m]."""


@dataclass(frozen=True)
class Box:
    """A rectangle.

    Attributes:
        centre: Position of the centre (2,) [m].
        size: Full side lengths along its own axes (2,) [m].
        angle: Rotation of the box's axes, counter-clockwise [rad].
    """

    centre: tuple[float, float]
    size: tuple[float, float]
    angle: float = 0.0

    def signed_distance(self, points: ArrayLike) -> Array:
        """Return the distance of points (..., 2) to the boundary, negative inside (...) [m]."""
        offset = np.asarray(points, dtype=float) - self.centre
        c, s = np.cos(self.angle), np.sin(self.angle)
        local = np.stack((c * offset[..., 0] + s * offset[..., 1], -s * offset[..., 0] + c * offset[..., 1]), axis=-1)
        beyond = np.abs(local) - 0.5 * np.asarray(self.size)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
        return outside + np.minimum(beyond.max(axis=-1), 0.0)


@dataclass(frozen=True)
class Disc:
    """A disc: centre (2,) [m] and radius [m]."""

    centre: tuple[float, float]
    radius: float

    def signed_distance(self, points: ArrayLike) -> Array:
        """Return the distance of points (..., 2) to the boundary, negative inside (...) [m]."""
        return np.linalg.norm(np.asarray(points, dtype=float) - self.centre, axis=-1) - self.radius


Shape = Box | Disc


class Solids:
    """A union of shapes: vectorised for a single point, and processed in cache-sized blocks for many points."""

    _AT_ONCE = 100_000

    def __init__(self, shapes: Sequence[Shape]) -> None:
        boxes = [shape for shape in shapes if isinstance(shape, Box)]
        discs = [shape for shape in shapes if isinstance(shape, Disc)]
        self._count = len(shapes)
        self._centres = np.array([box.centre for box in boxes] + [disc.centre for disc in discs]).reshape(-1, 2)
        self._boxes = len(boxes)
        self._half = 0.5 * np.array([box.size for box in boxes]).reshape(-1, 2)
        angles = np.array([box.angle for box in boxes])
        self._cos, self._sin = np.cos(angles), np.sin(angles)
        self._radii = np.array([disc.radius for disc in discs])

    def signed_distance(self, points: ArrayLike) -> Array:
        """Return the distance of points (..., 2) to the nearest shape, negative inside (...) [m]; +inf if empty."""
        points = np.asarray(points, dtype=float)
        flat = points.reshape(-1, 2)
        if not self._count:
            return np.full(points.shape[:-1], np.inf)
        step = max(1, self._AT_ONCE // self._count)
        pieces = [self._nearest(flat[begin : begin + step]) for begin in range(0, len(flat), step)]
        return np.concatenate(pieces).reshape(points.shape[:-1]) if pieces else np.zeros(points.shape[:-1])

    def _nearest(self, points: Array) -> Array:
        offset = points[:, None, :] - self._centres
        x, y = offset[:, : self._boxes, 0], offset[:, : self._boxes, 1]
        beyond_x = np.abs(self._cos * x + self._sin * y) - self._half[:, 0]
        beyond_y = np.abs(self._cos * y - self._sin * x) - self._half[:, 1]
        outside = np.hypot(np.maximum(beyond_x, 0.0), np.maximum(beyond_y, 0.0))
        boxes = outside + np.minimum(np.maximum(beyond_x, beyond_y), 0.0)
        if not len(self._radii):
            return boxes.min(axis=1)
        discs = np.hypot(offset[:, self._boxes :, 0], offset[:, self._boxes :, 1]) - self._radii
        return np.concatenate((boxes, discs), axis=1).min(axis=1)


def signed_distance(shapes: Sequence[Shape], points: ArrayLike) -> Array:
    """Return the distance of points (..., 2) to the nearest shape, negative inside (...) [m]; +inf if empty."""
    return Solids(shapes).signed_distance(points)


def frame_walls(x: tuple[float, float], y: tuple[float, float], thickness: float) -> tuple[Box, ...]:
    """Return the four walls [m] just outside the rectangle x by y."""
    width, height = x[1] - x[0] + 2 * thickness, y[1] - y[0]
    middle = (0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1]))
    return (
        Box((x[0] - 0.5 * thickness, middle[1]), (thickness, height)),
        Box((x[1] + 0.5 * thickness, middle[1]), (thickness, height)),
        Box((middle[0], y[0] - 0.5 * thickness), (width, thickness)),
        Box((middle[0], y[1] + 0.5 * thickness), (width, thickness)),
    )


@dataclass(frozen=True)
class Arc:
    """A segment of a path with constant curvature.

    Attributes:
        length: Length along the arc [m].
        curvature: Curvature, positive to the left [rad/m]; 0 for a straight segment.
    """

    length: float
    curvature: float


class Opening(NamedTuple):
    """A part of a path beside which one side has no wall.

    Attributes:
        low: Begin along the path [m].
        high: End along the path [m].
        side: 1.0 for the left side, -1.0 for the right one.
    """

    low: float
    high: float
    side: float


@dataclass(frozen=True)
class ArcPath:
    """A smooth plane path of arcs, from `start` in direction `heading`.

    Attributes:
        arcs: Segments in order, with continuous tangents.
        start: First point (2,) [m].
        heading: Direction at the first point [rad].
    """

    arcs: tuple[Arc, ...]
    start: tuple[float, float] = (0.0, 0.0)
    heading: float = 0.0

    @property
    def length(self) -> float:
        """Arc length of the whole path [m]."""
        return sum(arc.length for arc in self.arcs)

    def pose(self, s: ArrayLike) -> Array:
        """Return poses (..., 3) [m, m, rad] at arc lengths s (...); the path continues straight beyond its ends."""
        s = np.asarray(s, dtype=float)
        out = np.empty((*s.shape, 3))
        x, y, heading, begin = *self.start, self.heading, 0.0
        arcs = (*self.arcs, Arc(np.inf, 0.0))
        for arc in arcs:
            here = s >= begin if begin > 0.0 else np.ones(s.shape, dtype=bool)
            curvature = np.where(s < 0.0, 0.0, arc.curvature)
            out[here] = _along(x, y, heading, (s - begin)[here], curvature[here])
            if np.isfinite(arc.length):
                x, y, heading = _along(x, y, heading, np.asarray(arc.length), np.asarray(arc.curvature))
                begin += arc.length
        return out

    def walls(
        self, width: float, thickness: float = 0.05, largest_sag: float = 0.002, openings: Sequence[Opening] = ()
    ) -> tuple[Box, ...]:
        """Return boxes along both sides of the path at distance width / 2, gapless but for the openings.

        Args:
            width: Free width between the walls [m].
            thickness: Thickness of the walls, towards the outside [m].
            largest_sag: Maximum intrusion of a straight box into the free width, at its middle or ends [m].
            openings: Parts of the path beside which a side has no wall.

        Raises:
            ValueError: The path has a radius below half the width.
        """
        boxes: list[Box] = []
        begin = 0.0
        for arc in self.arcs:
            if abs(arc.curvature) * 0.5 * width >= 1.0:
                raise ValueError(
                    f"a turn of radius {1 / abs(arc.curvature):.3g} m is too tight for a width of {width:.3g} m"
                )
            placed: list[tuple[float, float, Arc]] = []
            for side in (1.0, -1.0):
                for low, length in _closed(begin, arc.length, side, openings):
                    count = _pieces(Arc(length, arc.curvature), width, largest_sag)
                    piece = Arc(length / count, arc.curvature)
                    placed.extend((begin + low + (k + 0.5) * length / count, -side, piece) for k in range(count))
            placed.sort(key=lambda each: each[:2])
            poses = self.pose([middle for middle, _, _ in placed])
            for (x, y, heading), (_, sense, piece) in zip(poses, placed, strict=True):
                boxes.append(_wall_piece(x, y, heading, -sense, piece, width, thickness))
            begin += arc.length
        return tuple(boxes)


@dataclass(frozen=True)
class World:
    """Walls and obstacles of one episode.

    Attributes:
        walls: Boxes around the arena or along the corridor.
        obstacles: Static obstacles within the walls.
        path: Centre line of the corridor; None in an arena.
        width: Free width of the corridor [m]; None in an arena.
    """

    walls: tuple[Box, ...]
    obstacles: tuple[Shape, ...]
    path: ArcPath | None
    width: float | None

    def signed_distance(self, points: ArrayLike) -> Array:
        """Return the distance of points (..., 2) to the nearest wall or obstacle, negative inside one (...) [m]."""
        return self._solids.signed_distance(points)

    @cached_property
    def _solids(self) -> Solids:
        return Solids((*self.walls, *self.obstacles))


def _along(x: float, y: float, heading: float, s: Array, curvature: Array) -> Array:
    """Return the poses (..., 3) after s metres of constant curvature (...)."""
    turn = s * curvature
    chord = s * np.sinc(turn / (2 * np.pi))  # 2 / k * sin(k s / 2), finite for k = 0
    direction = heading + 0.5 * turn
    return np.stack((x + chord * np.cos(direction), y + chord * np.sin(direction), heading + turn), axis=-1)


def _closed(begin: float, length: float, side: float, openings: Sequence[Opening]) -> list[tuple[float, float]]:
    """Return the begin and length of each part of an arc beside which a side has a wall [m], from the arc's begin."""
    parts = [(0.0, length)]
    for opening in openings:
        if opening.side != side:
            continue
        low, high = opening.low - begin, opening.high - begin
        for first, long in parts.copy():
            last = first + long
            if low < last and high > first:
                parts.remove((first, long))
                parts += [(a, b - a) for a, b in ((first, low), (high, last)) if b - a > _SHORTEST_WALL]
    return parts


def _pieces(arc: Arc, width: float, largest_sag: float) -> int:
    if arc.curvature == 0.0:
        return 1
    outer = 1.0 / abs(arc.curvature) + 0.5 * width
    half_angle = np.arccos(max(0.0, 1.0 - largest_sag / outer))
    return max(1, int(np.ceil(abs(arc.curvature) * arc.length / (2 * half_angle))))


def _wall_piece(x: float, y: float, heading: float, side: float, piece: Arc, width: float, thickness: float) -> Box:
    """Return one straight box beside the path segment centred at (x, y), longer on the outside of a turn."""
    inner_ratio = 1.0 - side * piece.curvature * 0.5 * width
    outer_ratio = 1.0 - side * piece.curvature * (0.5 * width + thickness)
    offset = side * 0.5 * (width + thickness)
    centre = (float(x - offset * np.sin(heading)), float(y + offset * np.cos(heading)))
    return Box(centre, (piece.length * max(inner_ratio, outer_ratio), thickness), float(heading))
