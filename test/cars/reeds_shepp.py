"""Length of the shortest path of a car that may reverse, with a bounded turning radius and no obstacles: closed form.

J. A. Reeds and L. A. Shepp, Optimal paths for a car that goes both forwards and backwards, Pacific Journal of
Mathematics 145, 1990: the least length over words of up to five arcs and lines, for a turning radius of 1. Each formula
holds for one word; reflection, reversal in time, and both give the others.
"""

from __future__ import annotations

import math

from numba import njit

_ROUNDING = 1e-10


@njit(cache=True)
def _wrap(angle: float) -> float:
    """Return an angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@njit(cache=True)
def _csc(x: float, y: float, phi: float) -> float:
    """L+ S+ L+ and L+ S+ R+ (formulas 8.1 and 8.2)."""
    least = math.inf
    a, b = x - math.sin(phi), y - 1.0 + math.cos(phi)
    u, t = math.hypot(a, b), math.atan2(b, a)
    v = _wrap(phi - t)
    if t >= -_ROUNDING and v >= -_ROUNDING:
        least = t + u + v
    a, b = x + math.sin(phi), y - 1.0 - math.cos(phi)
    square = a * a + b * b
    if square >= 4.0:
        u = math.sqrt(square - 4.0)
        t = _wrap(math.atan2(b, a) + math.atan2(2.0, u))
        v = _wrap(t - phi)
        if t >= -_ROUNDING and v >= -_ROUNDING:
            least = min(least, t + u + v)
    return least


@njit(cache=True)
def _ccc(x: float, y: float, phi: float) -> float:
    """L+ R- L (formulas 8.3 and 8.4)."""
    a, b = x - math.sin(phi), y - 1.0 + math.cos(phi)
    away = math.hypot(a, b)
    if away > 4.0:
        return math.inf
    u = -2.0 * math.asin(0.25 * away)
    t = _wrap(math.atan2(b, a) + 0.5 * u + math.pi)
    v = _wrap(phi - t + u)
    return t - u + abs(v) if t >= -_ROUNDING and u <= _ROUNDING else math.inf


@njit(cache=True)
def _outer(u: float, v: float, a: float, b: float, phi: float) -> tuple[float, float]:
    """Return the first and the last arc of a word of four."""
    delta = _wrap(u - v)
    p, q = math.sin(u) - math.sin(delta), math.cos(u) - math.cos(delta) - 1.0
    first = math.atan2(b * p - a * q, a * p + b * q)
    ahead = 2.0 * (math.cos(delta) - math.cos(v) - math.cos(u)) + 3.0
    t = _wrap(first + math.pi) if ahead < 0.0 else _wrap(first)
    return t, _wrap(t - u + v - phi)


@njit(cache=True)
def _cccc(x: float, y: float, phi: float) -> float:
    """L+ R+ L- R- and L+ R- L- R+ (formulas 8.7 and 8.8)."""
    least = math.inf
    a, b = x + math.sin(phi), y - 1.0 - math.cos(phi)
    rho = 0.25 * (2.0 + math.hypot(a, b))
    if rho <= 1.0:
        u = math.acos(rho)
        t, v = _outer(u, -u, a, b, phi)
        if t >= -_ROUNDING and v <= _ROUNDING:
            least = t + 2.0 * u - v
    rho = (20.0 - a * a - b * b) / 16.0
    if 0.0 <= rho <= 1.0:
        u = -math.acos(rho)
        if u >= -0.5 * math.pi:
            t, v = _outer(u, u, a, b, phi)
            if t >= -_ROUNDING and v >= -_ROUNDING:
                least = min(least, t - 2.0 * u + v)
    return least


@njit(cache=True)
def _ccsc(x: float, y: float, phi: float) -> float:
    """L+ R- S- L- and L+ R- S- R-, with a quarter turn as their second arc (formulas 8.9 and 8.10)."""
    least = math.inf
    a, b = x - math.sin(phi), y - 1.0 + math.cos(phi)
    away, theta = math.hypot(a, b), math.atan2(b, a)
    if away >= 2.0:
        r = math.sqrt(away * away - 4.0)
        u = 2.0 - r
        t = _wrap(theta + math.atan2(r, -2.0))
        v = _wrap(phi - 0.5 * math.pi - t)
        if t >= -_ROUNDING and u <= _ROUNDING and v <= _ROUNDING:
            least = t + 0.5 * math.pi - u - v
    a, b = x + math.sin(phi), y - 1.0 - math.cos(phi)
    away, theta = math.hypot(a, b), math.atan2(a, -b)
    if away >= 2.0:
        t, u = theta, 2.0 - away
        v = _wrap(t + 0.5 * math.pi - phi)
        if t >= -_ROUNDING and u <= _ROUNDING and v <= _ROUNDING:
            least = min(least, t + 0.5 * math.pi - u - v)
    return least


@njit(cache=True)
def _ccscc(x: float, y: float, phi: float) -> float:
    """L+ R- S- L- R+, with quarter turns as its second and fourth arcs (formula 8.11)."""
    a, b = x + math.sin(phi), y - 1.0 - math.cos(phi)
    away = math.hypot(a, b)
    if away < 2.0:
        return math.inf
    u = 4.0 - math.sqrt(away * away - 4.0)
    if u > _ROUNDING:
        return math.inf
    t = _wrap(math.atan2((4.0 - u) * a - 2.0 * b, -2.0 * a + (u - 4.0) * b))
    v = _wrap(t - phi)
    return t - u + v + math.pi if t >= -_ROUNDING and v >= -_ROUNDING else math.inf


@njit(cache=True)
def shortest(x: float, y: float, phi: float) -> float:
    """Return the length of the shortest path from (0, 0, 0) to (x, y, phi), for a turning radius of 1."""
    least = math.inf
    # The same path driven backwards joins the poses in the other order: words that are not symmetric differ.
    back_x, back_y = x * math.cos(phi) + y * math.sin(phi), x * math.sin(phi) - y * math.cos(phi)
    for flip in (1.0, -1.0):
        for mirror in (1.0, -1.0):
            turned = phi * flip * mirror
            a, b = x * flip, y * mirror
            least = min(least, _csc(a, b, turned), _ccc(a, b, turned), _cccc(a, b, turned))
            least = min(least, _ccsc(a, b, turned), _ccscc(a, b, turned))
            a, b = back_x * flip, back_y * mirror
            least = min(least, _ccc(a, b, turned), _ccsc(a, b, turned))
    return least
