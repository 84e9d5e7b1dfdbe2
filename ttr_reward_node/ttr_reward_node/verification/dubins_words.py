"""Shortest paths of a car between two poses (Dubins 1957; words as in Shkel, Lumelsky 2001), at 1 m/s and 1 rad/s."""

from __future__ import annotations

import math

import numpy as np
from ctrl_rl_core.values import cached_njit

LSL, RSR, LSR, RSL, RLR, LRL = range(6)
TURNS = np.array([[1, 0, 1], [-1, 0, -1], [1, 0, -1], [-1, 0, 1], [-1, 1, -1], [1, -1, 1]])


@cached_njit
def positive(angle: float) -> float:
    """Wrap an angle to [0, 2 pi); a full turn up to rounding becomes 0."""
    angle = angle % (2 * math.pi)
    return 0.0 if angle > 2 * math.pi - 1e-12 else angle


@cached_njit
def word(kind: int, x: float, y: float, angle: float) -> tuple[float, float, float]:
    """Return segments (t, p, q) of one word from the origin to (x, y, angle); inf if it does not exist."""
    none = (math.inf, math.inf, math.inf)
    d = math.hypot(x, y)
    direction = math.atan2(y, x)
    a, b = -direction, angle - direction
    sa, ca, sb, cb, cab = math.sin(a), math.cos(a), math.sin(b), math.cos(b), math.cos(a - b)
    if kind == 0 or kind == 1:
        s = 1.0 if kind == 0 else -1.0
        square = 2 + d * d - 2 * cab + 2 * s * d * (sa - sb)
        if square < 0:
            if square < -1e-12:
                return none
            square = 0.0
        turn = math.atan2(s * (cb - ca), d + s * (sa - sb))
        return positive(s * (turn - a)), math.sqrt(square), positive(s * (b - turn))
    if kind == 2 or kind == 3:
        s = 1.0 if kind == 2 else -1.0
        square = -2 + d * d + 2 * cab + 2 * s * d * (sa + sb)
        if square < 0:
            return none
        p = math.sqrt(square)
        turn = math.atan2(-s * (ca + cb), d + s * (sa + sb)) - math.atan2(-s * 2.0, p)
        return positive(s * (turn - a)), p, positive(s * (turn - b))
    s = 1.0 if kind == 4 else -1.0
    cosine = (6 - d * d + 2 * cab + 2 * s * d * (sa - sb)) / 8
    if abs(cosine) > 1:
        return none
    p = positive(2 * math.pi - math.acos(cosine))
    t = (
        positive(s * a - math.atan2(s * (ca - cb), d - s * (sa - sb)) * s * s + p / 2)
        if kind == 4
        else positive(-a - math.atan2(ca - cb, d + sa - sb) + p / 2)
    )
    q = positive(a - b - t + p) if kind == 4 else positive(b - a - t + p)
    return t, p, q


@cached_njit
def end_of(
    kind: int, t: float, p: float, q: float, x: float, y: float, angle: float, s: float
) -> tuple[float, float, float]:
    """Return the pose after s metres of the word with segments (t, p, q)."""
    lengths = (t, p, q)
    for i in range(3):
        step = min(s, lengths[i])
        turn = TURNS[kind, i]
        if turn == 0:
            x += step * math.cos(angle)
            y += step * math.sin(angle)
        else:
            x += turn * (math.sin(angle + turn * step) - math.sin(angle))
            y -= turn * (math.cos(angle + turn * step) - math.cos(angle))
            angle += turn * step
        s -= step
    return x, y, angle
