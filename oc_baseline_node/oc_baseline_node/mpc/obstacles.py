"""Obstacles as smooth constraints: superellipses around a box or disc inflated by the robot's clearance d_min.

A box inflated by d_min is a rectangle with rounded corners. The superellipse around it has the same proportions and is
scaled until it touches the corners. It covers the rounded box, so a position outside of it keeps d_min from the real
box. The p-norm grows like the distance, which suits solvers better than its p-th power.

Around a long box, a single superellipse would extend far beyond the ends and block a door there, so a long box gets
three: a shorter one, and one at each end.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin
from typing import Any

import numpy as np

from ctrl_rl_core import Box, Shape

EXPONENT = 6
"""Exponent of the superellipse around a box: higher fits the box more closely but is slower to solve."""
_OVERSHOOT = 0.1
"""Maximum distance by which a superellipse may exceed the shape it covers [m], before a box is covered by three."""
_ROUNDED = 1e-9
"""Smooths the norm's tip, so that its derivative is finite at the centre of an obstacle."""


@dataclass(frozen=True)
class Superellipse:
    """The set |a / semi_axes[0]|^p + |b / semi_axes[1]|^p < 1, with (a, b) along its own axes.

    Attributes:
        centre: Centre of the superellipse (2,) [m].
        semi_axes: Lengths of the semi-axes (2,) [m].
        exponent: p, an even number.
        angle: Angle of its own axes, counter-clockwise [rad].
    """

    centre: tuple[float, float]
    semi_axes: tuple[float, float]
    exponent: int
    angle: float = 0.0

    def outside(self, x: Any, y: Any) -> Any:
        """Return the approximate distance of (x, y) [m], negative inside. Smooth; works with arrays and CasADi."""
        c, s = cos(self.angle), sin(self.angle)
        dx, dy = x - self.centre[0], y - self.centre[1]
        a = (c * dx + s * dy) / self.semi_axes[0]
        b = (c * dy - s * dx) / self.semi_axes[1]
        norm = (a**self.exponent + b**self.exponent + _ROUNDED) ** (1.0 / self.exponent)
        return min(self.semi_axes) * (norm - 1.0)


def covering_superellipses(shape: Shape, clearance: float, exponent: int = EXPONENT) -> tuple[Superellipse, ...]:
    """Return superellipses that tightly cover all points within `clearance` [m] of `shape`."""
    whole = covering_superellipse(shape, clearance, exponent)
    if not isinstance(shape, Box):
        return (whole,)
    long = 0 if shape.size[0] >= shape.size[1] else 1
    if whole.semi_axes[long] - 0.5 * shape.size[long] - clearance <= _OVERSHOOT:
        return (whole,)
    # The middle piece's overshoot ends within the end pieces.
    end = max(shape.size[1 - long], whole.semi_axes[long] - 0.5 * shape.size[long] - clearance)
    if shape.size[long] <= 2.0 * end:
        return tuple(
            covering_superellipse(_piece(shape, long, side * 0.25, 0.5), clearance, exponent) for side in (-1.0, 1.0)
        )
    share = end / shape.size[long]
    pieces = [_piece(shape, long, side * 0.5 * (1.0 - share), share) for side in (-1.0, 1.0)]
    return tuple(
        covering_superellipse(piece, clearance, exponent)
        for piece in (_piece(shape, long, 0.0, 1.0 - 2.0 * share), *pieces)
    )


def _piece(box: Box, axis: int, middle: float, share: float) -> Box:
    """Return a piece of a box along one of its axes; `middle` and `share` are fractions of its length."""
    length = box.size[axis]
    c, s = cos(box.angle), sin(box.angle)
    dx, dy = ((c, s), (-s, c))[axis]
    size = (share * length, box.size[1]) if axis == 0 else (box.size[0], share * length)
    centre = (box.centre[0] + middle * length * dx, box.centre[1] + middle * length * dy)
    return Box(centre, size, box.angle)


def covering_superellipse(shape: Shape, clearance: float, exponent: int = EXPONENT) -> Superellipse:
    """Return a superellipse that covers all points within `clearance` [m] of `shape`; exact for a disc."""
    if not isinstance(shape, Box):
        radius = shape.radius + clearance
        return Superellipse(shape.centre, (radius, radius), 2)
    half = 0.5 * np.asarray(shape.size)
    corner = np.linspace(0.0, 0.5 * pi, 91)
    rounded = half + clearance * np.column_stack((np.cos(corner), np.sin(corner)))
    scale = float(np.max(np.sum((rounded / (half + clearance)) ** exponent, axis=1) ** (1.0 / exponent)))
    # Between two points of the corner, the norm is larger by at most this factor.
    semi_axes = max(scale, 1.0) * (1.0 + 1e-4) * (half + clearance)
    return Superellipse(shape.centre, (float(semi_axes[0]), float(semi_axes[1])), exponent, shape.angle)
